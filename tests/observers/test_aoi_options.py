"""The AOI's options as a user meets them: chosen in the configuration, seen on the tags."""

from typing import Any

import numpy as np
import pytest

from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.reference.aoi_options import AoiOptionsState, aoi_options_lreal, aoi_options_real
from softplc.observers.aoi import OFF, AoiConfig
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.sample import Reason, StatusCode
from tests.kernel.settled import slowest_time_constant
from tests.observers.rig import Rig, make_rig

BLEED = {"threshold": 1.0, "factor": 0.9}
CHOICES: dict[str, dict[str, Any]] = {
    "joseph": {"joseph": True},
    "min_r": {"min_r": 2.0},
    "gain_limits": {"joseph": True, "gain_limits": {"K0": (0.2, 0.3), "K1": (0.1, 0.2)}},
    "K0 alone": {"joseph": True, "gain_limits": {"K0": (0.2, 0.3)}},
    "dt": {"q_mode": "dt"},
    "white_accel": {"q_mode": "white_accel", "r_mode": "density"},
    "q_exponents": {"q_exponents": (2, 1)},
    "bleed_on": {"bleed": {**BLEED, "bleed_on": "innovation"}},
    "bleed_gate": {"bleed": {**BLEED, "bleed_gate": "velocity", "velocity_limit": 3.0}},
    "gate": {"gate": {"sigma": 3.0, "most_in_a_row": 2}},
    "on_s_not_positive": {"on_s_not_positive": "reinitialise"},
    "first_sample": {"reference": "first_sample"},
    "reference": {"reference": 1000.0},
}


def configured(**chosen: Any) -> AoiConfig:
    return AoiConfig.model_validate({"type": "aoi", "q_x": 0.01, "q_x_dot": 0.1, "r_x": 4 / 3, **chosen})


def rig_of(*, spec: dict[str, Any] | None = None, **chosen: Any) -> Rig:
    return make_rig((AxisSpec("A0", **(spec or {})), configured(**chosen)))


def track(scans: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """A ramp of 10 u/s that stops half-way, with noise and one outlier in thirty."""
    rng = np.random.default_rng(4)
    truth = np.minimum(0.5 * np.arange(scans), 0.25 * scans) + 1000.0
    return truth + rng.uniform(-2, 2, scans) + 80.0 * (rng.random(scans) < 1 / 30)


@pytest.mark.parametrize("precision", ["lreal", "real"])
@pytest.mark.parametrize("name", CHOICES)
def test_each_option_gives_the_reference_bit_for_bit(name: str, precision: str):
    config = configured(precision=precision, **CHOICES[name])
    step = aoi_options_real if precision == "real" else aoi_options_lreal
    bleed = (True, config.bleed.threshold, config.bleed.factor) if config.bleed else (False, 0.0, 1.0)
    rig = make_rig((AxisSpec("A0"), config))
    state, options = AoiOptionsState(), config.options
    assert options != OFF

    for z in track(200):
        rig.scan(z)
        inputs = AoiInputs(True, z, 50.0, config.q_x, config.q_x_dot, config.r_x, *bleed)
        state, _ = step(state, inputs, options)
        aoi = state.aoi
        leaves = ("Velocity", "Innovation", "S", "K0", "K1", "P00", "P01", "P11")
        expected = [aoi.y_dot, aoi.y_res, aoi.S, aoi.K0, aoi.K1, aoi.P[0], aoi.P[1], aoi.P[3]]
        assert [rig.get(leaf) for leaf in leaves] == [float(value) for value in expected]
        assert rig.get("Position") == state.position
        if config.gate:
            assert rig.get("Rejected") == state.rejected


def test_axes_with_and_without_options_are_stepped_apart_so_that_the_plain_ones_stay_fast():
    assert configured().group_key == ("aoi", "lreal")
    assert {configured(**chosen).group_key for chosen in CHOICES.values()} == {("aoi", "lreal", "options")}


def test_axes_with_different_options_and_the_same_tags_share_one_observer():
    rig = make_rig(
        (AxisSpec("A0"), configured(q_mode="white_accel")),
        (AxisSpec("A1"), configured(reference="first_sample", joseph=True)),
        (AxisSpec("A2"), configured(bleed=BLEED, on_s_not_positive="reinitialise")),
    )
    for z in track(50):
        rig.scan(z, z, z)

    assert len({rig.get("Velocity", axis) for axis in range(3)}) == 3


@pytest.mark.parametrize(
    ("chosen", "units"),
    [
        ({}, ("mm2", "(mm/s)2", "mm2")),
        ({"q_mode": "dt"}, ("mm2/s", "mm2/s3", "mm2")),
        ({"q_mode": "white_accel", "r_mode": "density"}, ("mm2/s", "mm2/s3", "mm2.s")),
        ({"q_exponents": (2, 3)}, ("mm2/s2", "mm2/s5", "mm2")),
    ],
)
def test_the_tuning_tags_have_the_unit_that_the_mode_gives_them(chosen: dict[str, Any], units: tuple[str, ...]):
    tags = {tag.name: tag for tag in axis_tags(AxisSpec("X", "mm"), configured(**chosen))}

    assert tuple(tags[f"X.{leaf}"].unit for leaf in ("q_x", "q_x_dot", "r_x")) == units
    assert ("per scan" in tags["X.q_x"].description) == (units[0] == "mm2")


@pytest.mark.parametrize(
    ("chosen", "shown"),
    [
        ({"min_r": 2.0}, {"min_r": 2.0}),
        ({"gate": {}}, {"GateSigma": 5.0, "GateMost": 5.0}),
        ({"bleed": {**BLEED, "bleed_on": "innovation"}}, {"BleedOn": 1.0}),
        ({"bleed": {**BLEED, "bleed_gate": "velocity", "velocity_limit": 3.0}}, {"BleedVelocity": 3.0}),
    ],
)
def test_options_in_use_show_their_numbers_among_the_tuning_tags(chosen: dict[str, Any], shown: dict[str, float]):
    rig = rig_of(**chosen)
    rig.scan(1.0)

    assert {leaf: rig.get(leaf) for leaf in shown} == shown
    assert rig.outcome()[1] == Reason.INITIALISING


def test_a_rejected_sample_is_counted_and_marked_and_the_prediction_is_published():
    rig = rig_of(gate={"sigma": 5.0, "most_in_a_row": 2})
    for k in range(200):
        rig.scan(0.5 * k)
    assert rig.get("Rejected") == 0

    rig.scan(500.0)

    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_GATE)
    assert rig.get("Position") == pytest.approx(100.0, abs=1e-5)
    assert (rig.get("Rejected"), rig.status("Rejected"), rig.get("Raw")) == (1, StatusCode.GOOD, 500.0)
    assert rig.get("NIS") > 25.0

    rig.scan(100.5)
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert (rig.get("Rejected"), rig.get("Position")) == (1, pytest.approx(100.5, abs=1e-5))


def test_a_rejected_sample_that_is_repeated_is_not_good_for_it():
    spec = {"on_repeat": "predict", "dt_source": "source"}
    rig = rig_of(spec=spec, gate={"sigma": 5.0, "most_in_a_row": 2})
    for k in range(200):
        rig.scan(0.5 * k)
    rig.scan(500.0)

    rig.again()
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_GATE)
    assert rig.get("Position") == pytest.approx(100.5, abs=1e-5)
    assert rig.get("Rejected") == 1

    rig.scan(101.0)
    rig.again()
    assert rig.outcome() == (StatusCode.GOOD, Reason.PREDICTED)


@pytest.mark.parametrize("period", [0.002, 0.01, 0.05, 0.1, 0.5])
def test_one_configuration_has_the_same_time_constant_in_tasks_of_any_period(period: float):
    """0.604 s: a fixed property of q_x_dot 2 u²/s³ and r_x 4/3·0.05 u²·s."""
    config = configured(q_mode="white_accel", r_mode="density", q_x=0.0, q_x_dot=2.0, r_x=4 / 3 * 0.05)
    rig = make_rig((AxisSpec("A0"), config), period=period)
    for _ in range(max(round(4.0 / period), 30)):  # P settles twice as fast as x̂: e^-13 is left
        rig.scan(0.0)

    assert slowest_time_constant(rig.get("K0"), rig.get("K1"), period) == pytest.approx(0.604, rel=0.01)


def test_a_jump_that_lasts_is_believed_after_the_permitted_rejections():
    rig = rig_of(gate={"sigma": 5.0, "most_in_a_row": 2})
    for _ in range(100):
        rig.scan(0.0)

    reasons = []
    for _ in range(4):
        rig.scan(500.0)
        reasons.append(rig.outcome()[1])

    assert reasons == [Reason.INNOVATION_GATE, Reason.INNOVATION_GATE, Reason.INITIALISING, Reason.NONE]
    assert (rig.get("Position"), rig.get("Rejected")) == (500.0, 2)


@pytest.mark.parametrize(
    ("chosen", "recovers"),
    [({}, False), ({"on_s_not_positive": "reinitialise"}, True), ({"joseph": True}, True)],
)
def test_a_covariance_that_a_real_loses_is_flagged_for_good_or_ends_with_a_start_anew_or_joseph_prevents_it(
    chosen: dict[str, Any], recovers: bool
):
    """Without process noise P shrinks to r_x; this r_x is so small beside the start's P that rounding makes S < 0."""
    config = configured(precision="real", q_x=0.0, q_x_dot=0.0, r_x=4e-7, **chosen)
    rig = make_rig((AxisSpec("A0"), config), period=1.0)
    for k in range(150):
        rig.scan(0.5 * k)
    stopped = 0.5 * 149
    for _ in range(50):
        rig.scan(stopped)

    if recovers:  # though without process noise it cannot follow the stop, and says so
        assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.FAR_OFF)
        assert rig.get("S") > 0
    else:
        assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_VARIANCE)
        assert rig.get("S") <= 0
        assert rig.get("Position") == stopped + 50 * 0.5  # runs on at the speed it had


@pytest.mark.parametrize("reference", ["first_sample", 2.0**25])
def test_a_real_with_a_reference_counts_single_counts_at_33_million(reference: Any):
    plain, referenced = rig_of(precision="real"), rig_of(precision="real", reference=reference)
    errors: list[list[float]] = [[], []]
    for k in range(600):
        for rig, own in zip((plain, referenced), errors, strict=True):
            rig.scan(2.0**25 + 0.5 * k)
            own.append(abs(rig.get("Velocity") / 10.0 - 1.0))

    assert max(errors[0][100:]) > 0.5  # seen 0.52
    assert max(errors[1][100:]) < 1e-4
    assert referenced.get("Position") == pytest.approx(2.0**25 + 0.5 * 599, abs=1e-3)
    assert referenced.get("Raw") == 2.0**25 + 0.5 * 599


def test_predictions_and_passing_through_are_absolute_with_a_reference_too():
    spec = {"on_repeat": "predict", "dt_source": "source", "enable_writable": True}
    rig = rig_of(spec=spec, precision="real", reference="first_sample")
    for k in range(200):
        rig.scan(2.0**25 + 0.5 * k)
    rig.again()
    assert rig.outcome()[1] == Reason.PREDICTED
    assert rig.get("Position") == pytest.approx(2.0**25 + 100.0, abs=1e-3)

    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    rig.scan(2.0**25 + 101.0)
    assert rig.outcome()[1] == Reason.DISABLED
    assert rig.get("Position") == 2.0**25 + 101.0


def over_twenty_bad_scans(skipped_time: str) -> tuple[float, float, float]:
    """Position, velocity and Skipped in the scan after them, on a ramp of 10 u/s that has come to 110."""
    rig = make_rig((AxisSpec("A0", reinit_after=3.0, skipped_time=skipped_time), configured()))  # type: ignore[arg-type]
    for k in range(200):
        rig.scan(0.5 * k)
    for _ in range(20):
        rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    rig.scan(110.0)
    return rig.get("Position"), rig.get("Velocity"), rig.get("Skipped")


def test_time_of_twenty_bad_scans_is_kept_or_lost_as_told_and_they_are_counted():
    kept, lost = over_twenty_bad_scans("accumulate"), over_twenty_bad_scans("lose")

    assert kept == pytest.approx((110.0, 10.0, 20), abs=1e-4)
    assert lost == (pytest.approx(101.70, abs=0.005), pytest.approx(12.49, abs=0.005), 20)


def test_scans_in_which_no_time_went_by_count_as_skipped_and_those_of_a_disabled_axis_do_not():
    rig = rig_of(spec={"enable_writable": True})
    for k in range(5):
        rig.scan(0.5 * k)
    rig.scan(3.0, dt=0.0)
    assert (rig.get("Skipped"), rig.status("Skipped")) == (1, StatusCode.GOOD)

    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    assert rig.get("Skipped") == 1


@pytest.mark.parametrize(("threshold", "velocity"), [(0.5, 7.40), (1.0, 5.99), (2.0, 4.87)])
def test_bleed_reads_low_on_a_ramp_and_its_velocity_gate_does_not(threshold: float, velocity: float):
    bleed = {"threshold": threshold, "factor": 0.9}
    gate = {**bleed, "bleed_gate": "velocity", "velocity_limit": 2.0}
    noise = np.random.default_rng(0).uniform(-2, 2, 1200)

    def mean(chosen: dict[str, Any]) -> float:
        rig, velocities = rig_of(bleed=chosen), []
        for k in range(300):
            rig.scan(0.5 * (k + 1) + noise[k])
            velocities.append(rig.get("Velocity"))
        return float(np.mean(velocities[150:]))

    assert mean(bleed) == pytest.approx(velocity, abs=0.005)  # given with two decimals; the seed fixes the noise
    assert mean(gate) == pytest.approx(10.0, abs=0.1)
