"""Tuning that is written while the observer runs, and Reset: bumpless, checked, and shown as it is used."""

import math

import numpy as np
import pytest

from softplc.kernel.diagnosis import Diagnosis
from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.aoi import AoiConfig, Bleed
from softplc.observers.aoi_options import Gate
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.observers.leaves import LEAVES
from softplc.sample import Reason, StatusCode
from softplc.tags import DataType
from tests.observers.rig import CONFIG, ESTIMATES, Rig, make_rig

SPEC = AxisSpec("A0", tuning_writable=True)
REAL = CONFIG.model_copy(update={"precision": "real"})
ADAPTIVE = AdaptiveConfig(type="adaptive", r_x=1.0, top_speed=10.0, top_acceleration=100.0)
TUNING = ("q_x", "q_x_dot", "r_x", "BleedEnable", "BleedThresh", "BleedFactor")


def write(rig: Rig, leaf: str, value: float, axis: int = 0) -> bool:
    return rig.observer.command(rig.table.index(f"A{axis}.{leaf}"), value)


def ramp(rig: Rig, scans: int, z: float = 0.0) -> float:
    for _ in range(scans):
        z += 0.5
        rig.scan(z)
    return z


def estimates(rig: Rig, axis: int = 0) -> list[float]:
    return [rig.get(leaf, axis) for leaf in ESTIMATES]


def test_a_new_tuning_is_used_from_the_next_scan_on_and_the_state_goes_on_from_where_it_was():
    rig, twin = make_rig(SPEC), make_rig(SPEC)
    z = ramp(rig, 100)
    ramp(twin, 100)
    before = estimates(rig)

    assert write(rig, "r_x", 40.0)
    assert estimates(rig) == before  # nothing moves until the next scan
    rig.scan(z + 0.5)
    twin.scan(z + 0.5)

    assert rig.get("Innovation") == twin.get("Innovation")  # the prediction does not know of r_x
    assert rig.get("r_x") == 40.0
    P00, r_x = twin.get("S") - 4 / 3, 40.0
    assert rig.get("S") == pytest.approx(P00 + r_x, rel=1e-12)
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)


@pytest.mark.parametrize("config", [CONFIG, REAL])
@pytest.mark.parametrize(("leaf", "value"), [("q_x", 5.0), ("q_x_dot", 50.0), ("r_x", 0.001), ("r_x", 1e4)])
def test_there_is_no_step_in_position_velocity_or_covariance(config: AoiConfig, leaf: str, value: float):
    """On a noise-free ramp the innovation is nil, so whatever the gains become, the estimate stays on the ramp."""
    rig = make_rig((SPEC, config))
    z = ramp(rig, 400)
    P11 = rig.get("P11")

    assert write(rig, leaf, value)
    for _ in range(50):
        z += 0.5
        rig.scan(z)
        assert rig.get("Position") == pytest.approx(z, abs=2e-3)  # a REAL has 2e-5 there, and velocity's times dt
        assert rig.get("Velocity") == pytest.approx(10.0, abs=2e-2)
        # P11 grows by what is added in a scan and no more; never back to the 10 of a start
        assert rig.get("P11") <= P11 + rig.get("q_x_dot") + 1e-6
        P11 = rig.get("P11")


def test_the_tag_shows_the_value_in_use_rounded_in_a_real_and_stamped_with_its_scan():
    rig = make_rig((SPEC, REAL))
    rig.scan(1.0)
    first = rig.stamp("r_x")
    rig.scan(1.0)
    assert rig.stamp("r_x") == first

    assert write(rig, "r_x", 0.1)
    rig.scan(1.0)

    assert rig.get("r_x") == float(np.float32(0.1))
    assert rig.stamp("r_x") == pytest.approx(rig.now, abs=1e-9)
    assert rig.stamp("q_x") == first


def test_bleed_is_switched_on_and_off_on_the_fly():
    config = CONFIG.model_copy(update={"bleed": Bleed(threshold=100.0, factor=0.5)})
    rig = make_rig((SPEC, config))
    z = ramp(rig, 100)
    bleeding = rig.get("Velocity")
    assert write(rig, "BleedEnable", 0.0)
    ramp(rig, 200, z)
    assert (rig.get("BleedEnable"), rig.get("Velocity")) == (0.0, pytest.approx(10.0, abs=0.1))
    assert bleeding < 5.0
    assert write(rig, "BleedEnable", 1.0)
    rig.scan(rig.get("Raw"))
    assert rig.get("BleedEnable") == 1.0


@pytest.mark.parametrize(
    ("leaf", "value"),
    [
        ("r_x", 0.0),
        ("r_x", -1.0),
        ("q_x", -1e-300),
        ("q_x_dot", -0.1),
        ("BleedThresh", -1.0),
        ("BleedFactor", 0.0),
        ("BleedFactor", 1.0),
        ("BleedFactor", 1.5),
        ("BleedEnable", 2.0),
        ("BleedEnable", 0.5),
        *((leaf, value) for leaf in TUNING for value in (math.nan, math.inf, -math.inf)),
    ],
)
@pytest.mark.parametrize("config", [CONFIG, REAL])
def test_a_value_that_cannot_be_used_is_refused_and_leaves_no_trace(config: AoiConfig, leaf: str, value: float):
    rig, twin = make_rig((SPEC, config)), make_rig((SPEC, config))
    ramp(rig, 10)
    ramp(twin, 10)
    assert not write(rig, leaf, value)
    ramp(rig, 10)
    ramp(twin, 10)
    assert estimates(rig) == estimates(twin)
    assert [rig.get(name) for name in TUNING] == [twin.get(name) for name in TUNING]


@pytest.mark.parametrize(
    ("leaf", "value"), [("r_x", 1e-50), ("r_x", 1e39), ("q_x", 1e39), ("BleedFactor", 1 - 1e-12)]
)
def test_what_a_real_cannot_hold_is_refused_where_the_observer_computes_in_real(leaf: str, value: float):
    assert write(make_rig(SPEC), leaf, value)
    assert not write(make_rig((SPEC, REAL)), leaf, value)
    limits = next(tag.limits for tag in axis_tags(SPEC, REAL) if tag.name == f"A0.{leaf}")
    assert limits is not None
    for bound in limits:
        assert float(np.float32(bound)) == bound


def test_without_the_key_nobody_writes_the_tuning():
    rig = make_rig(AxisSpec("A0", enable_writable=True))
    assert not any(write(rig, leaf, 0.5) for leaf in TUNING)
    writable = {tag.name for tag in axis_tags(AxisSpec("A0", enable_writable=True), CONFIG) if tag.writable}
    assert writable == {"A0.Enable", "A0.Reset"}


def test_with_the_key_tuning_and_reset_are_writable_and_enable_is_not():
    tags = axis_tags(SPEC, CONFIG)
    assert {tag.name for tag in tags if tag.writable} == {"A0.Reset", *(f"A0.{leaf}" for leaf in TUNING)}
    assert all(tag.limits is not None for tag in tags if tag.writable and tag.name != "A0.Reset")
    assert not write(make_rig(SPEC), "Enable", 0.0)


def test_limits_of_the_catalogue_allow_what_the_configuration_allows():
    for leaf in LEAVES.values():
        if leaf.limits is not None:
            assert leaf.limits[0] < leaf.limits[1]
            assert leaf.data_type is not DataType.BOOLEAN or leaf.limits == (0.0, 1.0)


def test_only_the_written_axis_changes():
    rig = make_rig(SPEC, AxisSpec("A1", tuning_writable=True))
    rig.scan(1.0, 1.0)
    assert write(rig, "r_x", 7.0, axis=1)
    rig.scan(2.0, 2.0)
    assert (rig.get("r_x", 0), rig.get("r_x", 1)) == (4 / 3, 7.0)


def test_a_new_tuning_is_judged_by_new_innovations_alone():
    rig = make_rig(AxisSpec("A0", tuning_writable=True, consistency=(50, 3)))
    rng = np.random.default_rng(0)
    for _ in range(80):
        rig.scan(rng.normal(0, 10))
    assert rig.get("Consistency") == Diagnosis.R_TOO_SMALL
    assert write(rig, "r_x", 100.0)
    rig.scan(rng.normal(0, 10))
    assert rig.get("Consistency") == Diagnosis.NOT_ENOUGH_DATA
    for _ in range(200):
        rig.scan(rng.normal(0, 10))
    assert rig.get("Consistency") == Diagnosis.CONSISTENT


def test_reset_starts_the_axis_anew_with_its_next_sample_once_for_each_rising_edge():
    rig, fresh = make_rig(SPEC), make_rig(SPEC)
    ramp(rig, 100)

    assert write(rig, "Reset", 1.0)
    outcomes = []
    for z in (80.0, 80.3, 80.9):
        rig.scan(z)
        fresh.scan(z)
        outcomes.append(rig.outcome()[1])
        assert estimates(rig) == estimates(fresh)
        assert rig.get("Reset") == 1.0
    assert outcomes == [Reason.INITIALISING, Reason.NONE, Reason.NONE]

    assert write(rig, "Reset", 1.0)  # still true: no edge
    rig.scan(81.5)
    assert rig.outcome()[1] == Reason.NONE
    assert write(rig, "Reset", 0.0)
    rig.scan(82.0)
    assert (rig.get("Reset"), rig.outcome()[1]) == (0.0, Reason.NONE)
    assert write(rig, "Reset", 1.0)
    assert write(rig, "Reset", 0.0)  # a pulse between two scans counts
    rig.scan(82.5)
    assert (rig.get("Reset"), rig.outcome()[1]) == (0.0, Reason.INITIALISING)


@pytest.mark.parametrize("config", [CONFIG.model_copy(update={"gate": Gate()}), ADAPTIVE])
def test_what_is_counted_since_the_start_goes_on_after_a_reset(config: AoiConfig | AdaptiveConfig):
    rig = make_rig((SPEC, config))
    ramp(rig, 100)
    rig.scan(1e6)
    rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    counted = [rig.get("Rejected"), rig.get("Skipped")]
    assert counted[0] == 1.0
    assert counted[1] >= 1.0

    assert write(rig, "Reset", 1.0)
    rig.scan(80.0)
    assert rig.outcome()[1] == Reason.INITIALISING
    assert [rig.get("Rejected"), rig.get("Skipped")] == counted


def test_reset_on_a_lost_link_keeps_to_what_is_held_and_starts_when_a_sample_comes():
    rig = make_rig(AxisSpec("A0", enable_writable=True))
    ramp(rig, 50)
    assert write(rig, "Reset", 1.0)
    rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_BAD)
    rig.scan(7.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert rig.get("Position") == 7.0


def test_reset_frees_an_axis_whose_innovation_variance_is_stuck():
    config = AoiConfig.model_construct(type="aoi", precision="lreal", q_x=0.0, q_x_dot=0.0, r_x=-2.0, bleed=None)
    rig = make_rig((SPEC, config))
    rig.scan(1.0)
    rig.scan(1.0)
    assert rig.outcome()[1] == Reason.INNOVATION_VARIANCE
    assert write(rig, "r_x", 2.0)
    assert write(rig, "Reset", 1.0)
    rig.scan(3.0)
    rig.scan(3.0)
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)


def test_options_of_the_aoi_are_tuned_on_the_fly_as_well():
    config = AoiConfig(type="aoi", r_x=1.0, min_r=0.5, gate=Gate(sigma=3.0, most_in_a_row=2))
    rig = make_rig((SPEC, config))
    for k in range(40):
        rig.scan(0.1 * (k % 2))
    assert write(rig, "GateMost", 3.0)
    assert not write(rig, "GateMost", 2.5)
    assert not write(rig, "min_r", 0.0)
    assert write(rig, "GateSigma", 1000.0)
    rig.scan(50.0)
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)  # let in: the gate was opened
    assert [rig.get(leaf) for leaf in ("GateSigma", "GateMost", "min_r", "Rejected")] == [1000.0, 3.0, 0.5, 0.0]
