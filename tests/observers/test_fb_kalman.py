"""FB_KalmanFilter as an observer: the block's numbers on the tags, and what the service adds around it."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from softplc.kernel.reference.fb_kalman import FbKalmanInputs, FbKalmanState
from softplc.observers.axes import AxisSpec
from softplc.observers.fb_kalman import FbKalmanConfig, FbKalmanKernel
from softplc.observers.kernel import Given
from softplc.sample import Reason, StatusCode
from tests.kernel.fb_kalman_sequences import CALLS
from tests.observers.faults import LIMITS, Fault, apply, assert_back, faults, good
from tests.observers.rig import ESTIMATES, Rig, make_rig

FORMS = sorted(CALLS)
GOOD = (StatusCode.GOOD, Reason.NONE)


def config(variant: str = "as_written", precision: str = "lreal", **more: Any) -> FbKalmanConfig:
    given: dict[str, Any] = {"variant": variant, "precision": precision, "Q": 0.1, "R": 1.0, **more}
    return FbKalmanConfig(type="fb_kalman", **given)


def rig_of(one: FbKalmanConfig, **spec: Any) -> Rig:
    return make_rig((AxisSpec("A0", **spec), one), period=0.1)


def shown(rig: Rig) -> list[float]:
    return [rig.get(leaf) for leaf in ESTIMATES]


@pytest.mark.parametrize(("variant", "precision"), FORMS)
def test_tags_are_the_reference_bit_for_bit_with_each_axis_own_tuning(variant: str, precision: str):
    configs = [config(variant, precision, Q=Q, R=R) for Q, R in ((0.1, 1.0), (1e-4, 0.3), (10.0, 50.0))]
    rig = make_rig(*[(AxisSpec(f"A{i}"), one) for i, one in enumerate(configs)])
    states = [FbKalmanState() for _ in configs]

    for z in np.cumsum(np.random.default_rng(7).uniform(-1, 2, (200, 3)), axis=0):
        dt = 0.05 + 0.01 * z[0] % 0.003
        rig.scan(*z, dt=dt)
        for i, one in enumerate(configs):
            inputs = FbKalmanInputs(z[i], one.Q, one.R, dt, start_at_measurement=variant == "corrected")
            states[i], _ = CALLS[variant, precision](states[i], inputs)
            s = states[i]
            expected = [s.x_pos, s.x_vel, s.y_res, s.S, s.KalmanGain, s.k_vel, s.p_11, s.p_12, s.p_22]
            assert [rig.get(leaf, i) for leaf in ESTIMATES[:9]] == [float(value) for value in expected]
            assert rig.get("NIS", i) == float(s.y_res) * float(s.y_res) / float(s.S)
            assert rig.get("Dt", i) == dt


def test_tuning_tags_show_what_is_used():
    rig = make_rig((AxisSpec("A0", unit="mm"), config(precision="real", R=4 / 3)))
    rig.scan(1.0)
    assert (rig.get("Q"), rig.get("R")) == (float(np.float32(0.1)), float(np.float32(4 / 3)))
    units = {tag.name: tag.unit for block in rig.table.blocks for tag in block.tags}
    assert (units["A0.Q"], units["A0.R"]) == ("(mm/s)2", "mm2")


def test_as_written_an_object_at_rest_is_seen_to_run_and_the_status_says_good():
    rig = rig_of(config())

    positions, velocities, outcomes = [], [], []
    for _ in range(60):
        rig.scan(10.5)
        positions.append(rig.get("Position"))
        velocities.append(rig.get("Velocity"))
        outcomes.append(rig.outcome())

    assert (max(positions), max(velocities)) == (pytest.approx(14.997, abs=5e-4), pytest.approx(32.1, abs=0.05))
    assert outcomes == [(StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING), *[GOOD] * 59]


def test_corrected_starts_at_the_measurement_and_an_object_at_rest_stays_at_rest():
    rig = rig_of(config("corrected"))

    for _ in range(60):
        rig.scan(10.5)
        assert (rig.get("Position"), rig.get("Velocity")) == (10.5, 0.0)


def test_corrected_may_start_at_zero_to_be_compared_with_a_block_that_was_cured_in_the_plc():
    rig, state = rig_of(config("corrected", start="zero")), FbKalmanState()

    for _ in range(60):
        rig.scan(10.5)
        state, _ = CALLS["corrected", "lreal"](state, FbKalmanInputs(10.5, 0.1, 1.0, 0.1))
        assert (rig.get("Position"), rig.get("Velocity")) == (state.x_pos, state.x_vel)


@pytest.mark.parametrize(("variant", "precision"), FORMS)
def test_disabled_passes_through_and_the_scan_that_enables_calls_with_reset_once(variant: str, precision: str):
    one = config(variant, precision)
    rig, fresh = rig_of(one, enable_writable=True), rig_of(one)
    enable = rig.table.index("A0.Enable")
    for k in range(20):
        rig.scan(float(k))

    rig.observer.command(enable, 0.0)
    rig.scan(7.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert (rig.get("Position"), rig.get("Velocity")) == (7.0, 0.0)

    rig.observer.command(enable, 1.0)
    for z in (3.0, 3.5, 4.0):
        rig.scan(z)
        fresh.scan(z)
        assert shown(rig) == shown(fresh)


@pytest.mark.parametrize("variant", ["as_written", "corrected"])
def test_a_start_without_a_time_step_passes_through_and_the_next_scan_starts(variant: str):
    rig = rig_of(config(variant))

    rig.scan(10.5, dt=0.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DT_INVALID)
    assert (rig.get("Position"), rig.get("Velocity")) == (10.5, 0.0)

    rig.scan(10.5)
    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)


@pytest.mark.parametrize("variant", ["as_written", "corrected"])
@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan])
def test_a_scan_in_which_no_time_passed_never_divides_by_it(variant: str, dt: float):
    rig = rig_of(config(variant))
    for k in range(10):
        rig.scan(0.3 * k)
    before = rig.get("Position"), rig.get("Velocity")

    rig.inputs.values[0] = 99.0
    rig.step(dt)
    assert (rig.get("Position"), rig.get("Velocity")) == before
    assert rig.outcome()[1] == Reason.PREDICTED

    rig.scan(3.3)
    assert rig.outcome() == GOOD


def test_a_gap_longer_than_the_axis_allows_starts_anew():
    rig, fresh = rig_of(config("corrected"), reinit_after=0.5, reinit_samples=1), rig_of(config("corrected"))
    for k in range(10):
        rig.scan(float(k))
    for _ in range(8):
        rig.fail(StatusCode.BAD_SENSOR_FAILURE)

    rig.scan(50.0)
    fresh.scan(50.0)

    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert shown(rig) == shown(fresh)


def test_tuning_that_is_changed_works_from_the_next_step_on_and_keeps_the_state():
    kernel, state = FbKalmanKernel([config("corrected", start="zero")]), FbKalmanState()
    one = np.array([True])
    for k in range(40):
        kernel.tuning["R"][0] = R = 1.0 if k < 20 else 9.0
        kernel.step(Given(one, np.array([0.3 * k]), np.array([0.1]), one, np.array([np.nan])))
        state, _ = CALLS["corrected", "lreal"](state, FbKalmanInputs(0.3 * k, 0.1, R, 0.1))
        assert (kernel.estimates["Position"][0], kernel.estimates["P00"][0]) == (state.x_pos, state.p_11)


def test_variants_starts_and_precisions_are_stepped_apart():
    some = [
        config(),
        config(precision="real"),
        config("corrected"),
        config("corrected", start="zero"),
        config("corrected", "real"),
    ]
    assert len({one.group_key for one in some}) == len(some)
    assert config().group_key == config(start="zero", Q=5.0).group_key
    with pytest.raises(ValueError, match="group_key"):
        make_rig((AxisSpec("A0"), some[0]), (AxisSpec("A1"), some[1]))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"start": "measurement"}, "expected zero as the block is written"),
        ({"precision": "real", "Q": 1e39}, "does not fit a REAL"),
        ({"precision": "real", "R": 1e-39}, "does not fit a REAL"),
        ({"R": 0.0}, "greater than 0"),
        ({"Q": -0.1}, "greater than or equal to 0"),
        ({"variant": "cured"}, "as_written"),
    ],
)
def test_a_configuration_that_cannot_work_is_refused(given: dict[str, Any], text: str):
    with pytest.raises(ValidationError, match=text):
        config(**given)


AXES = (
    AxisSpec("A0", range=LIMITS),
    AxisSpec("A1", range=LIMITS, dt_source="source", on_repeat="predict", held_after=0.3, enable_writable=True),
    AxisSpec("A2", range=LIMITS, dt_source="arrival", reinit_after=0.3),
    AxisSpec("A3", dt_source="source"),  # no range: numbers of any size are taken
)


@pytest.mark.parametrize(("variant", "precision"), FORMS)
@pytest.mark.filterwarnings("error")
@settings(max_examples=40, deadline=None)
@given(scans=st.lists(faults(4), max_size=30))
def test_after_any_faults_one_good_second_brings_every_axis_back(variant: str, precision: str, scans: list[Fault]):
    rig = make_rig(*[(spec, config(variant, precision)) for spec in AXES])
    for fault in scans:
        apply(rig, fault)
        for axis in range(len(AXES)):
            status, _ = rig.outcome(axis)
            if status < StatusCode.BAD:
                assert all(np.isfinite(rig.get(leaf, axis)) for leaf in (*ESTIMATES[:2], *ESTIMATES[3:9]))
                assert 0.0 <= rig.get("K0", axis) <= 1.0

    good(rig, 20)

    assert_back(rig, ranged=0 if variant == "as_written" else 3)  # as written it swings far and for long


@pytest.mark.parametrize("variant", ["as_written", "corrected"])
@settings(max_examples=10, deadline=None)
@given(scans=st.lists(faults(3), min_size=5, max_size=30))
def test_after_any_faults_an_axis_with_a_range_comes_to_the_position_again(variant: str, scans: list[Fault]):
    rig = make_rig(*[(spec, config(variant)) for spec in AXES[:3]])
    for fault in scans:
        apply(rig, fault)

    good(rig, 1200)

    positions = [rig.get("Position", axis) for axis in range(3)]
    velocities = [rig.get("Velocity", axis) for axis in range(3)]
    # the slower pole of both is at 0.92 here; a minute is e^-98, so rounding of the largest number is left
    assert positions == pytest.approx([7.0] * 3, abs=1e-6)
    assert velocities == pytest.approx([0.0] * 3, abs=1e-6)


@pytest.mark.parametrize(("variant", "precision"), FORMS)
@settings(max_examples=40, deadline=None)
@given(
    samples=st.lists(
        st.one_of(st.floats(*LIMITS), st.sampled_from([(np.nan,), (np.inf,), (-np.inf,), (1e6,), (-1e308,)])),
        min_size=1,
        max_size=40,
    )
)
def test_what_was_rejected_leaves_no_trace_whatever_it_was(
    variant: str, precision: str, samples: list[float | tuple[float]]
):
    one, other = (rig_of(config(variant, precision), range=LIMITS) for _ in range(2))

    for sample in samples:
        if isinstance(sample, tuple):
            one.scan(*sample)
            if other.scans:
                other.now += other.period
            other.inputs.fail(StatusCode.BAD_SENSOR_FAILURE)
            other.step()
        else:
            one.scan(sample)
            other.scan(sample)
            assert shown(one) == shown(other)


def test_fault_of_one_axis_leaves_the_others_as_they_would_be():
    pair = make_rig((AxisSpec("A0"), config()), (AxisSpec("A1"), config()), period=0.1)
    alone = rig_of(config())
    for k in range(30):
        pair.scan(np.inf if k % 7 == 3 else 1e300, 0.3 * k)
        alone.scan(0.3 * k)
        assert [pair.get(leaf, 1) for leaf in ESTIMATES] == shown(alone)
