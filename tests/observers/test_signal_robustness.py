"""Whatever comes in: positions within their bounds, NaN means Bad, and the others are not touched."""

import math

import numpy as np
import pytest

from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec
from softplc.observers.signal_config import SignalSpec
from softplc.sample import Reason, Sample, StatusCode
from tests.observers.rig import CONFIG, UTC, make_rig

SIGNALS = (
    None,
    SignalSpec(modulo=360.0, quantum=0.1, dead_band=0.2, max_rate=1e4, max_rate_samples=2),
    SignalSpec(counter=655.36, max_rate=1e4),
    SignalSpec(counter=65536 * 0.36, modulo=360.0, dead_band=0.1),
    SignalSpec(quantum=0.5),
)
WILD = (math.nan, math.inf, -math.inf, 1e9, -1e9, 1e300, 1e-300, -0.0)
STATUSES = (
    StatusCode.BAD_NO_COMMUNICATION,
    StatusCode.BAD_SENSOR_FAILURE,
    StatusCode.UNCERTAIN,
    StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
)


@pytest.mark.parametrize("dt_source", ["scan", "source", "arrival"])
@pytest.mark.parametrize("precision", ["lreal", "real"])
def test_faults_of_every_kind_leave_every_output_a_number_in_bounds_or_bad(dt_source: str, precision: str):
    config = AoiConfig(type="aoi", q_x=0.01, q_x_dot=1.0, r_x=0.1, precision=precision)  # type: ignore[arg-type]
    specs = [
        AxisSpec(f"A{i}", signal=signal, dead_time=0.01, dt_source=dt_source, tuning_writable=True)  # type: ignore[arg-type]
        for i, signal in enumerate(SIGNALS)
    ]
    own, random = make_rig(*((spec, config) for spec in specs)), np.random.default_rng(7)
    for k in range(500):
        for axis in range(len(specs)):
            value, status = (300.0 + 11.0 * k) % 655.36, int(StatusCode.GOOD)
            if random.random() < 0.1:
                value = float(random.choice(WILD))
            if random.random() < 0.1:
                status = int(random.choice(STATUSES))
            stamp = UTC + round((100.0 + 0.05 * (k // int(random.integers(1, 3)))) * 1e9)
            own.inputs.put(axis, Sample(value, status, stamp), own.now if random.random() < 0.9 else own.now - 0.1)
        if random.random() < 0.01:
            assert own.observer.command(own.table.index(f"A{int(random.integers(0, 5))}.Reset"), float(k % 2))
        own.now += float(random.choice([0.05, 0.05, 0.05, 0.0, 0.001, 3.0], p=[0.3, 0.3, 0.3, 0.04, 0.04, 0.02]))
        own.step()
        for axis, signal in enumerate(SIGNALS):
            own.outcome(axis)  # one status for all estimates, and NaN means Bad
            for leaf in ("Position", "PositionNow", "Velocity", "VelocityNow", "Horizon"):
                assert not math.isinf(own.get(leaf, axis))
            if signal is not None and signal.modulo is not None:
                assert not own.get("Position", axis) < 0.0
                assert not own.get("Position", axis) >= 360.0
                assert not own.get("PositionNow", axis) < 0.0
                assert not own.get("PositionNow", axis) >= 360.0


def test_an_axis_without_a_signal_is_the_same_to_the_bit_beside_others_and_alone():
    mixed, alone = make_rig(*((AxisSpec(f"A{i}", signal=one), CONFIG) for i, one in enumerate(SIGNALS))), make_rig()
    random = np.random.default_rng(8)
    for k in range(300):
        z = float(random.normal(0.0, 1.0) if k % 17 else random.choice(WILD))
        mixed.scan(*(z,) * len(SIGNALS))
        alone.scan(z)
        for leaf in ("Position", "Velocity", "Innovation", "S", "P00", "Raw"):
            assert np.array_equal(mixed.get(leaf), alone.get(leaf), equal_nan=True)
        assert mixed.outcome() == alone.outcome()


def test_without_a_signal_nothing_is_done():
    samples = make_rig().observer._group.samples  # type: ignore[attr-defined]
    assert samples.signal is None
    assert samples.z is samples.read


def test_what_is_uncertain_is_conditioned_and_stays_uncertain():
    own = make_rig(AxisSpec("A0", signal=SignalSpec(modulo=360.0)))
    for k in range(50):
        own.scan((20.0 * k) % 360.0, status=StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)
    assert own.outcome() == (StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE, Reason.INPUT_UNCERTAIN)
    assert own.get("Velocity") == pytest.approx(400.0, rel=0.01)
