"""An axis beside the PLC's own AOI: what differs, how much at the most, and what is said when it is not known."""

import math

import numpy as np
import pytest

from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real
from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, Sample, StatusCode
from tests.observers.rig import CONFIG, UTC, Rig, make_rig

LEAVES = ("PositionDelta", "VelocityDelta", "PositionDeltaMax", "VelocityDeltaMax")
REAL = CONFIG.model_copy(update={"precision": "real"})


class Plc:
    """The AOI as the PLC of axis 0 runs it; its outputs go to the rig's inputs with each scan."""

    def __init__(self, rig: Rig, real: bool = False, **tuning: float) -> None:
        self.rig, self.state = rig, AoiState()
        self.run = aoi_real if real else aoi_lreal
        self.tuning = {"q_x": 0.01, "q_x_dot": 0.1, "r_x": 4 / 3, **tuning}

    def scan(self, z: float, dt_ms: float = 50.0, enable: bool = True) -> None:
        """The PLC's own scan; what it puts out waits among the inputs."""
        self.state, _ = self.run(self.state, AoiInputs(enable, z, dt_ms, **self.tuning))
        for offset, value in enumerate((self.state.y, self.state.y_dot, dt_ms)):
            self.rig.inputs.put(len(self.rig.inputs) - 3 + offset, Sample(float(value), StatusCode.GOOD, UTC))

    def spoil(self, offset: int, value: float, status: int) -> None:
        self.rig.inputs.put(len(self.rig.inputs) - 3 + offset, Sample(value, status, UTC))


def shadowed(**fields: object) -> AxisSpec:
    return AxisSpec("A0", shadow=("position", "velocity"), **fields)  # type: ignore[arg-type]


def deltas(rig: Rig) -> list[float]:
    return [rig.get(leaf) for leaf in LEAVES]


@pytest.mark.parametrize("real", [False, True])
def test_the_same_aoi_with_the_same_time_steps_differs_by_exactly_nothing(real: bool):
    """The PLC's dt jitters and is no round number; our own scans come at other intervals."""
    rig = make_rig((shadowed(), REAL if real else CONFIG), shadow_tags=True)
    plc, rng = Plc(rig, real), np.random.default_rng(2)
    for k in range(500):
        z = rng.uniform(-2, 2) + 0.5 * min(k, 250)
        dt = rng.uniform(45.0, 55.0)
        plc.scan(z, float(np.float32(dt)) if real else dt)
        rig.scan(z, dt=rng.uniform(0.045, 0.055))
        assert deltas(rig) == [0.0] * 4
        assert {rig.status(leaf) for leaf in LEAVES[2:]} == {StatusCode.GOOD}


def test_without_the_plcs_time_steps_a_jittering_scan_shows_in_the_differences():
    rig = make_rig(shadowed(), shadow_tags=True, shadow_dt=False)
    plc, rng = Plc(rig), np.random.default_rng(2)
    for k in range(100):
        plc.scan(0.5 * k, rng.uniform(45.0, 55.0))
        rig.scan(0.5 * k)
    assert rig.get("PositionDeltaMax") > 1e-6


def test_a_difference_is_ours_minus_the_plcs_and_its_largest_amount_is_kept():
    rig = make_rig(shadowed(), shadow_tags=True)
    plc = Plc(rig, r_x=5.0)
    largest = [0.0, 0.0]
    for k in range(60):
        z = 3.0 * (k % 7)
        plc.scan(z)
        rig.scan(z)
        assert rig.get("PositionDelta") == rig.get("Position") - plc.state.y
        assert rig.get("VelocityDelta") == rig.get("Velocity") - plc.state.y_dot
        largest = [max(a, abs(b)) for a, b in zip(largest, deltas(rig)[:2], strict=True)]
        assert deltas(rig)[2:] == largest
    assert min(largest) > 0.1


@pytest.mark.parametrize(
    ("value", "status", "shown"),
    [
        (math.nan, StatusCode.BAD_NODE_ID_UNKNOWN, StatusCode.BAD_NODE_ID_UNKNOWN),
        (math.nan, StatusCode.BAD_NO_COMMUNICATION, StatusCode.BAD_NO_COMMUNICATION),
        (math.nan, StatusCode.GOOD, StatusCode.BAD_OUT_OF_RANGE),
        (math.inf, StatusCode.GOOD, StatusCode.BAD_OUT_OF_RANGE),
    ],
)
def test_a_bad_output_of_the_plc_is_a_bad_difference_and_the_largest_is_kept(
    value: float, status: StatusCode, shown: StatusCode
):
    rig = make_rig(shadowed(), shadow_tags=True)
    plc = Plc(rig, r_x=5.0)
    for k in range(20):
        plc.scan(float(k % 5))
        rig.scan(float(k % 5))
    before = deltas(rig)
    plc.spoil(0, value, status)
    rig.scan(1.0)
    after = deltas(rig)
    assert math.isnan(after[0])
    assert after[2] == before[2]
    assert [rig.status(leaf) for leaf in ("PositionDelta", "PositionDeltaMax")] == [shown, StatusCode.GOOD]
    assert rig.status("VelocityDelta") == StatusCode.GOOD
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)


def test_an_uncertain_output_of_the_plc_makes_the_difference_uncertain():
    rig = make_rig(shadowed(), shadow_tags=True)
    plc = Plc(rig)
    for _ in range(2):
        plc.scan(1.0)
        rig.scan(1.0)
    plc.spoil(0, 1.0, StatusCode.UNCERTAIN_LAST_USABLE_VALUE)
    rig.scan(1.0)
    assert rig.status("PositionDelta") == StatusCode.UNCERTAIN_LAST_USABLE_VALUE


def test_what_was_never_compared_waits_for_data():
    rig = make_rig(shadowed(), shadow_tags=True)
    rig.scan(1.0)  # the PLC's outputs have not come yet
    for leaf in LEAVES:
        assert math.isnan(rig.get(leaf))
        assert rig.status(leaf) == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
    rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    assert rig.status("PositionDelta") == StatusCode.BAD_NO_COMMUNICATION


def test_scans_in_which_ours_did_not_step_are_not_compared():
    rig = make_rig(shadowed(dt_source="source", on_repeat="predict"), shadow_tags=True)
    plc = Plc(rig)
    for k in range(20):
        plc.scan(float(k))
        rig.scan(float(k), dt=0.0125)
        for _ in range(3):  # the PLC is slower than our scan
            rig.now += 0.0125
            rig.step(0.0125)
            assert rig.outcome() == ((StatusCode.GOOD, Reason.PREDICTED) if k else rig.outcome())
    assert rig.get("PositionDeltaMax") < 1e-9


def test_a_step_of_the_plc_that_cannot_span_the_time_is_not_used():
    """Our scan misses four of five samples: the PLC's 10 ms are not the time between the samples that we have."""
    rig = make_rig(shadowed(), shadow_tags=True)
    plc = Plc(rig)
    for k in range(400):
        plc.scan(0.1 * k, 10.0)
        if k % 5 == 0:
            rig.scan(0.1 * k)
    assert rig.get("Dt") == 0.05
    assert rig.get("Velocity") == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize("dt", [math.nan, math.inf, 0.0, -50.0, 1e9])
def test_an_absurd_step_of_the_plc_is_not_used(dt: float):
    rig = make_rig(shadowed(), shadow_tags=True)
    plc = Plc(rig)
    for k in range(50):
        plc.scan(0.5 * k)
        plc.spoil(2, dt, StatusCode.GOOD)
        rig.scan(0.5 * k)
        assert rig.get("Dt") == 0.05


def test_enabling_and_reset_begin_the_maxima_anew():
    rig = make_rig(shadowed(enable_writable=True), shadow_tags=True)
    plc = Plc(rig, r_x=5.0)

    def both(z: float, enable: bool = True) -> None:
        plc.scan(z, enable=enable)
        rig.scan(z)

    def write(leaf: str, value: float) -> None:
        assert rig.observer.command(rig.table.index(f"A0.{leaf}"), value)

    for k in range(20):
        both(float(k % 5))
    assert rig.get("PositionDeltaMax") > 0.0
    write("Enable", 0.0)
    both(1.0, enable=False)
    write("Enable", 1.0)
    plc.state = AoiState()
    both(1.0)
    assert deltas(rig) == [0.0] * 4

    for k in range(20):
        both(float(k % 5))
    assert rig.get("PositionDeltaMax") > 0.0
    write("Reset", 1.0)
    plc.state = AoiState()
    both(1.0)
    assert deltas(rig) == [0.0] * 4


def test_maxima_wait_until_two_that_started_apart_have_had_time_to_agree():
    rig = make_rig(shadowed(shadow_settling=60.0), shadow_tags=True)
    plc, rng = Plc(rig), np.random.default_rng(1)
    for _ in range(100):  # the PLC has run for long
        plc.scan(rng.normal())
    for k in range(1600):
        z = rng.normal()
        plc.scan(z)
        rig.scan(z)
        if k in (1150, 1250):  # 60 s are 1200 scans
            waits = rig.status("PositionDeltaMax") == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
            assert waits == (k == 1150)
    assert rig.get("PositionDeltaMax") < 1e-9  # the difference of two starts decays by a constant factor each scan


def test_only_what_the_plc_has_is_compared():
    rig = make_rig(AxisSpec("A0", shadow=("velocity",)), shadow_tags=True)
    assert "A0.VelocityDelta" in rig.table
    assert "A0.PositionDelta" not in rig.table
