"""What holds for every observer that needs no more than a position and its time; what is special has its own file."""

import time

import numpy as np
import pytest

from softplc.kernel.result import Result
from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, StatusCode
from tests.observers.motion import MODES, SPEED, axis, ramp
from tests.observers.rig import UTC, Rig, make_rig
from tests.observers.simple import CASES, NAMES, Case

pytestmark = pytest.mark.parametrize("case", CASES, ids=NAMES)


def rig_of(case: Case, **spec: object) -> Rig:
    """One axis for each configuration of the case."""
    pairs = [(AxisSpec(f"A{i}", **spec), config) for i, config in enumerate(case.configs)]  # type: ignore[arg-type]
    return make_rig(*pairs)


def one(case: Case, spec: AxisSpec | None = None, period: float = 0.05) -> Rig:
    """One axis with the first configuration."""
    return make_rig((spec or AxisSpec("A0"), case.configs[0]), period=period)


def test_tags_are_the_reference_bit_for_bit_with_each_axis_own_tuning(case: Case):
    rig = rig_of(case)
    states = [case.state() for _ in case.configs]
    z = np.cumsum(np.random.default_rng(7).uniform(-1, 2, (120, len(case.configs))), axis=0)

    for row in z:
        dt = 0.05 + 0.01 * row[0] % 0.003
        rig.scan(*row, dt=dt)
        for i, config in enumerate(case.configs):
            states[i], _ = case.reference(states[i], case.inputs(config, row[i], dt))
            for leaf, name in {"Position": "y", "Velocity": "y_dot", **case.leaves}.items():
                assert rig.get(leaf, i) == float(getattr(states[i], name)), leaf
            assert (rig.get("Raw", i), rig.get("Dt", i)) == (row[i], dt)
            if "S" in case.leaves:
                nis = float(states[i].y_res) * float(states[i].y_res) / float(states[i].S)
                assert rig.get("NIS", i) == nis


def test_every_leaf_of_the_model_is_filled_and_no_other(case: Case):
    leaves = set(case.configs[0].estimates) - {"NIS"}
    assert leaves == set(case.leaves)
    assert ("NIS" in case.configs[0].estimates) == ("S" in case.leaves)


@pytest.mark.parametrize(("dt_source", "on_repeat"), MODES)
def test_a_ramp_reads_its_slope_and_time_without_a_usable_sample_is_not_lost(case: Case, dt_source, on_repeat):
    rig = one(case, axis(dt_source, on_repeat))
    ramp(rig, 20.0)
    settled = rig.get("Velocity")
    if case.exact:
        assert settled == pytest.approx(SPEED, abs=1e-5)  # stamps are whole ns: 1e-8 of 50 ms, times gains

    lag = SPEED * rig.now - rig.get("Position")
    for _ in range(10):
        rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    rig.scan(SPEED * rig.next)

    assert rig.get("Dt") == pytest.approx(0.55)
    if case.exact:
        assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-5)
    assert abs(SPEED * rig.now - rig.get("Position")) < abs(lag) + 5.5  # no further off than what was travelled
    ramp(rig, 5.0)
    assert rig.get("Velocity") == pytest.approx(settled, rel=1e-3)


def test_the_first_sample_is_shown_at_rest_and_uncertain(case: Case):
    rig = one(case)
    rig.scan(3.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert (rig.get("Position"), rig.get("Velocity")) == (3.0, 0.0)


def test_outputs_are_uncertain_until_there_are_samples_enough_and_then_good(case: Case):
    rig, state, config = one(case), case.state(), case.configs[0]
    for k in range(15):
        rig.scan(0.5 * k)
        state, result = case.reference(state, case.inputs(config, 0.5 * k, 0.05))
        warm = result not in (Result.INITIALISED, Result.WARMING_UP)
        assert rig.outcome() == (
            (StatusCode.GOOD, Reason.NONE) if warm else (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
        )


def test_disabled_passes_through_and_enabled_starts_as_new(case: Case):
    rig, fresh = one(case, AxisSpec("A0", enable_writable=True)), one(case)
    ramp(rig, 1.0)
    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    rig.scan(77.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert (rig.get("Position"), rig.get("Velocity")) == (77.0, 0.0)

    rig.observer.command(rig.table.index("A0.Enable"), 1.0)
    for z in (5.0, 5.5, 7.0, 6.0, 5.0):
        rig.scan(z)
        fresh.scan(z)
        leaves = ("Position", "Velocity", *case.leaves)
        assert [rig.get(leaf) for leaf in leaves] == [fresh.get(leaf) for leaf in leaves]


def test_no_usable_time_step_at_the_start_passes_the_position_through(case: Case):
    rig = one(case)
    rig.scan(3.0, dt=0.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DT_INVALID)
    assert (rig.get("Position"), rig.get("Velocity")) == (3.0, 0.0)


def test_a_repeated_sample_is_predicted_at_the_velocity(case: Case):
    rig = one(case, axis("source", "predict"))
    ramp(rig, 20.0)
    position, velocity = rig.get("Position"), rig.get("Velocity")
    accelerated = "Acceleration" in case.leaves

    rig.again()

    assert rig.outcome() == (StatusCode.GOOD, Reason.PREDICTED)
    assert rig.get("Velocity") == pytest.approx(velocity, abs=1e-5 if accelerated else 0.0)
    assert rig.get("Position") == pytest.approx(position + 0.05 * velocity, abs=1e-5)


def test_a_state_that_is_no_number_is_never_shown_and_the_next_sample_starts_anew(case: Case):
    rig = one(case)
    big = 3e38 if "REAL" in case.name else 1.7e308
    overflowed = False
    for k in range(12):  # of the sum or of the difference
        rig.scan(big if k % 2 == 0 or "average" in case.name else -big)
        status, reason = rig.outcome()
        overflowed = overflowed or reason == Reason.NOT_FINITE
        assert np.isfinite(rig.get("Velocity")) == (status < StatusCode.BAD)
    assert overflowed

    for _ in range(30):
        rig.scan(5.0)
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)


def test_axes_of_one_observer_share_their_group_key(case: Case):
    others = [other.configs[0] for other in CASES if other.configs[0].type != case.configs[0].type]
    assert all(other.group_key != case.configs[0].group_key for other in others)
    with pytest.raises(ValueError, match="same group_key"):
        case.configs[0].build([], case.configs)


def test_tuning_tags_show_what_is_used(case: Case):
    rig = rig_of(case)
    rig.scan(*(1.0 for _ in case.configs))
    for i, config in enumerate(case.configs):
        inputs = case.inputs(config, 0.0, 0.0)
        for leaf in config.tuning:
            value = getattr(inputs, "beta" if leaf == "cutoff_slope" else leaf)
            assert rig.get(leaf, i) == (float(np.float32(value)) if "REAL" in case.name else value), leaf


def test_a_thousand_axes_cost_far_less_than_a_thousand_times_one(case: Case):
    def seconds(axes: int) -> float:
        rig = make_rig(*[(AxisSpec(f"A{i}"), case.configs[0]) for i in range(axes)])
        times = []
        for k in range(15):
            rig.now += 0.05
            rig.inputs.values[:], rig.inputs.arrivals[:] = float(k), rig.now
            rig.inputs.statuses[:], rig.inputs.source_timestamps[:] = StatusCode.GOOD, UTC + k * 50_000_000
            start = time.perf_counter()
            rig.step()
            times.append(time.perf_counter() - start)
        return min(times)

    # measured 2 to 4 times one axis; anything in Python for each axis would make it several hundred times
    assert seconds(1000) < 60 * seconds(1)
