"""Whatever a source delivers: nothing that is rejected enters the state, and good samples bring the axis back."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.aoi import AoiConfig, Bleed
from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import CONFIG, ESTIMATES, UTC, Rig, make_rig

LIMITS = (-1000.0, 1000.0)
AXES: tuple[tuple[AxisSpec, AoiConfig], ...] = (
    (AxisSpec("A0", range=LIMITS), CONFIG),
    (
        AxisSpec("A1", range=LIMITS, dt_source="source", on_repeat="predict", held_after=0.3, enable_writable=True),
        CONFIG,
    ),
    (
        AxisSpec("A2", range=LIMITS, dt_source="arrival", reinit_after=0.3),
        AoiConfig(type="aoi", q_x=1.0, r_x=0.001, bleed=Bleed(threshold=1.0, factor=0.5)),
    ),
    (AxisSpec("A3", dt_source="source"), CONFIG),  # no range: numbers of any size are taken
)


@dataclass(frozen=True)
class Fault:
    """One scan: what each axis reads, and how the clocks behave."""

    z: tuple[float, ...]
    status: int
    stamp: int
    arrival: float
    dt: float
    enable: bool


_values = st.one_of(
    st.floats(-1000.0, 1000.0), st.sampled_from([np.nan, np.inf, -np.inf, 1e6, -1e308, 1e308, 1000.0, -0.0, 5e-324])
)
_faults = st.builds(
    Fault,
    z=st.tuples(_values, _values, _values, _values),
    status=st.sampled_from(
        [
            StatusCode.GOOD,
            StatusCode.GOOD,
            StatusCode.GOOD,
            StatusCode.UNCERTAIN,
            StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
            StatusCode.BAD_SENSOR_FAILURE,
            StatusCode.BAD_NO_COMMUNICATION,
        ]
    ),
    stamp=st.one_of(st.sampled_from([0, UTC, UTC + 10**18, -(2**63), 2**63 - 1]), st.integers(UTC, UTC + 10**10)),
    arrival=st.one_of(st.floats(90.0, 110.0), st.just(np.nan)),
    dt=st.sampled_from([0.05, 0.05, 0.05, 0.0, -1.0, np.nan, 1e-9, 10.0]),
    enable=st.sampled_from([True, True, True, False]),
)


def apply(rig: Rig, fault: Fault) -> None:
    """One scan; a Bad input has no value, as the image promises."""
    rig.now += 0.05
    bad = fault.status >= StatusCode.BAD
    rig.inputs.values[:] = np.nan if bad else fault.z
    rig.inputs.statuses[:] = fault.status
    rig.inputs.source_timestamps[:] = fault.stamp
    rig.inputs.arrivals[:] = fault.arrival
    rig.observer.command(rig.table.index("A1.Enable"), float(fault.enable))
    rig.step(fault.dt)


def good(rig: Rig, scans: int) -> None:
    """Scans of 7.0 with everything in order."""
    rig.observer.command(rig.table.index("A1.Enable"), 1.0)
    for k in range(scans):
        rig.now += 0.05
        rig.inputs.values[:] = 7.0
        rig.inputs.statuses[:] = StatusCode.GOOD
        rig.inputs.source_timestamps[:] = UTC + 2 * 10**10 + k * 50_000_000
        rig.inputs.arrivals[:] = 200.0 + 0.05 * k
        rig.step()


@pytest.mark.filterwarnings("error")
@settings(max_examples=100, deadline=None)
@given(faults=st.lists(_faults, max_size=30))
def test_after_any_faults_one_good_second_brings_every_axis_back(faults: list[Fault]):
    rig = make_rig(*AXES)
    for fault in faults:
        apply(rig, fault)
        for axis in range(len(AXES)):
            status, _ = rig.outcome(axis)
            if status < StatusCode.BAD:
                assert all(np.isfinite(rig.get(leaf, axis)) for leaf in ("Velocity", "S", "K0", "K1", "P00", "P11"))
                assert 0.0 <= rig.get("K0", axis) <= 1.0

    good(rig, 20)

    assert [rig.outcome(axis) for axis in range(4)] == [(StatusCode.GOOD, Reason.NONE)] * 4


@settings(max_examples=10, deadline=None)
@given(faults=st.lists(_faults, min_size=5, max_size=30))
def test_after_any_faults_an_axis_with_a_range_finds_the_position_again(faults: list[Fault]):
    rig = make_rig(*AXES[:3])
    for fault in faults:
        apply(rig, replace(fault, z=fault.z[:3]))

    good(rig, 1200)

    positions = [rig.get("Position", axis) for axis in range(3)]
    # the slowest filter's time constant is 0.6 s here; a minute is e^-100, so rounding of the largest number is left
    assert positions == pytest.approx([7.0] * 3, abs=1e-6)


_rejected = st.sampled_from([np.nan, np.inf, -np.inf, 1e6, -1e308])
_accepted = st.floats(-1000.0, 1000.0)


@settings(max_examples=100, deadline=None)
@given(
    samples=st.lists(st.one_of(_accepted, st.tuples(_rejected, _rejected)), min_size=1, max_size=40),
    precision=st.sampled_from(["lreal", "real"]),
)
def test_what_was_rejected_leaves_no_trace_whatever_it_was(
    samples: list[float | tuple[float, float]], precision: str
):
    config = AoiConfig(type="aoi", precision=precision, r_x=4 / 3)  # type: ignore[arg-type]
    spec = AxisSpec("A0", range=LIMITS)
    one, other, bad = make_rig((spec, config)), make_rig((spec, config)), make_rig((spec, config))

    for sample in samples:
        if isinstance(sample, tuple):
            one.scan(sample[0])
            other.scan(sample[1])
            if bad.scans:
                bad.now += bad.period
            bad.inputs.fail(StatusCode.BAD_SENSOR_FAILURE)
            bad.step()
        else:
            for rig in (one, other, bad):
                rig.scan(sample)
            shown = [[rig.get(leaf) for leaf in ESTIMATES] for rig in (one, other, bad)]
            assert shown[0] == shown[1] == shown[2]
