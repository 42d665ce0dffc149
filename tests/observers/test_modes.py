"""What an axis shows without a usable sample, and how it comes back: the tables of docs/bad-inputs.md, row by row."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.kernel.reference.coast import aoi_coast
from softplc.observers.axes import AxisSpec
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.sample import AxisState, Reason, StatusCode
from tests.observers.faults import apply, faults
from tests.observers.rig import CONFIG, ESTIMATES, Rig, make_rig
from tests.observers.test_bad_input import OBSERVERS

S = StatusCode
SPEED = 10.0
SPEC = AxisSpec("A0", range=(-1000.0, 1000.0))


def running(spec: AxisSpec = SPEC, config: Any = CONFIG, scans: int = 60) -> Rig:
    rig = make_rig((spec, config))
    ramp(rig, scans)
    assert rig.outcome() == (S.GOOD, Reason.NONE)
    assert rig.get("State") == AxisState.RUN
    return rig


def ramp(rig: Rig, scans: int = 1, offset: float = 0.0) -> None:
    for _ in range(scans):
        rig.scan(SPEED * (rig.next - 100.0) + offset)


def state(rig: Rig) -> AxisState:
    return AxisState(int(rig.get("State")))


def stale(rig: Rig) -> None:
    """The source did not answer in this scan."""
    rig.again(S.UNCERTAIN_LAST_USABLE_VALUE)


def failing(status: StatusCode) -> Callable[[Rig], None]:
    return lambda rig: rig.fail(status)


CAUSES: dict[str, tuple[Callable[[Rig], None], Reason]] = {
    "bad": (failing(S.BAD_SENSOR_FAILURE), Reason.INPUT_BAD),
    "NaN": (lambda rig: rig.scan(math.nan), Reason.INPUT_NOT_FINITE),
    "infinite": (lambda rig: rig.scan(-math.inf), Reason.INPUT_NOT_FINITE),
    "outside": (lambda rig: rig.scan(1e9), Reason.INPUT_OUT_OF_RANGE),
    "stale": (stale, Reason.STALE),
    "lost": (failing(S.BAD_NO_COMMUNICATION), Reason.NO_COMMUNICATION),
    "timeout": (failing(S.BAD_TIMEOUT), Reason.NO_COMMUNICATION),
    "waiting": (failing(S.BAD_WAITING_FOR_INITIAL_DATA), Reason.WAITING),
    "missing": (failing(S.BAD_NODE_ID_UNKNOWN), Reason.CONFIGURATION),
}
LAST, LOST = S.UNCERTAIN_LAST_USABLE_VALUE, S.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE
HELD, CARRIED, RAW, NONE = "held", "carried on", "raw", "none"
ALIVE = ("bad", "NaN", "infinite", "outside", "stale")
DOWN = ("lost", "timeout", "waiting")
OWN = {
    "bad": S.BAD_SENSOR_FAILURE,
    "NaN": S.BAD_OUT_OF_RANGE,
    "infinite": S.BAD_OUT_OF_RANGE,
    "outside": S.BAD_OUT_OF_RANGE,
    "stale": S.BAD_NO_COMMUNICATION,
    "lost": S.BAD_NO_COMMUNICATION,
    "timeout": S.BAD_TIMEOUT,
    "waiting": S.BAD_WAITING_FOR_INITIAL_DATA,
    "missing": S.BAD_NODE_ID_UNKNOWN,
}
TABLE = (
    *(("hold", cause, HELD, LAST, AxisState.HOLD) for cause in ALIVE if cause != "outside"),
    ("hold", "outside", HELD, S.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED, AxisState.HOLD),
    *(("hold", cause, HELD, LOST, AxisState.HOLD) for cause in DOWN),
    *(("coast", cause, CARRIED, LAST, AxisState.COAST) for cause in ALIVE),
    *(("coast", cause, CARRIED, LOST, AxisState.COAST) for cause in DOWN),
    *(("passthrough", cause, RAW, S.UNCERTAIN_SUB_NORMAL, AxisState.PASSTHROUGH) for cause in ("outside", "stale")),
    *(("passthrough", cause, NONE, OWN[cause], AxisState.FAIL) for cause in ("bad", "NaN", "infinite", *DOWN)),
    *(("fail", cause, NONE, OWN[cause], AxisState.FAIL) for cause in (*ALIVE, *DOWN)),
    *(
        (policy, "missing", NONE, OWN["missing"], AxisState.FAIL)
        for policy in ("hold", "coast", "passthrough", "fail")
    ),
)


@pytest.mark.parametrize(("policy", "cause", "value", "status", "expected"), TABLE)
def test_what_is_shown_by_policy_and_cause(
    policy: Any, cause: str, value: str, status: StatusCode, expected: AxisState
):
    rig = running(replace(SPEC, on_bad=policy, on_lost=policy))
    before, used = [rig.get(leaf) for leaf in ESTIMATES], rig.stamp()
    happen, reason = CAUSES[cause]

    happen(rig)

    assert rig.outcome() == (status, Reason.PASSED_THROUGH if value == RAW else reason)
    assert state(rig) == expected
    after = [rig.get(leaf) for leaf in ESTIMATES]
    if value == HELD:
        assert after == before
    elif value == CARRIED:
        assert rig.get("Position") == before[0] + 0.05 * before[1]
        assert (rig.get("Velocity"), rig.get("Dt")) == (before[1], 0.05)
        assert [rig.get(leaf) for leaf in ("Innovation", "K0", "K1", "NIS")] == [0.0] * 4
        assert rig.get("P00") > before[ESTIMATES.index("P00")]
    elif value == RAW:
        assert (rig.get("Position"), rig.get("Velocity")) == (rig.get("Raw"), 0.0)
    if value != RAW:
        assert rig.stamp() == used
    else:
        assert rig.stamp() == rig.stamp("Raw")


@pytest.mark.parametrize("policy", ["hold", "coast", "passthrough", "fail"])
@pytest.mark.parametrize("cause", [cause for cause in CAUSES if cause not in ("outside", "stale")])
def test_an_axis_that_never_had_a_sample_is_bad_and_initialising_whatever_its_policy(policy: Any, cause: str):
    rig = make_rig((replace(SPEC, on_bad=policy, on_lost=policy, after_coast="hold"), CONFIG))
    rig.step()
    for _ in range(3):
        CAUSES[cause][0](rig)
    assert rig.outcome() == (OWN[cause], CAUSES[cause][1])
    assert state(rig) == AxisState.INIT


def test_the_second_sample_of_an_axis_is_good_and_running():
    rig = make_rig((SPEC, CONFIG))
    ramp(rig)
    assert (rig.outcome()[1], state(rig)) == (Reason.INITIALISING, AxisState.INIT)
    ramp(rig)
    assert (rig.outcome()[0], state(rig)) == (S.GOOD, AxisState.RUN)


def test_defaults_hold_on_a_live_link_and_fail_on_a_lost_one():
    assert (SPEC.on_bad, SPEC.on_lost, SPEC.reinit_samples) == ("hold", "fail", 3)


# Coasting


def test_a_coast_and_what_comes_after_it_are_the_kernels_own_numbers():
    rig = running(replace(SPEC, on_bad="coast", coast_max=1.0))
    reference = AoiState()
    inputs = AoiInputs(True, 0.0, 50.0, 0.01, 0.1, 4 / 3)
    for k in range(60):
        reference, _ = aoi_lreal(reference, replace(inputs, x=SPEED * (100.0 + k * 0.05 - 100.0)))

    variances = []
    for _ in range(8):
        rig.scan(math.nan)
        reference = aoi_coast(reference, inputs)
        assert (rig.get("P00"), rig.get("P01"), rig.get("P11"), rig.get("S")) == pytest.approx(
            (*reference.P[:2], reference.P[3], reference.S),
            rel=1e-9,  # the rig's scan times are sums of 0.05
        )
        variances.append(rig.get("P00"))
    assert variances == sorted(variances)
    ramp(rig)
    reference, _ = aoi_lreal(reference, replace(inputs, x=SPEED * (rig.now - 100.0)))

    assert rig.outcome() == (S.GOOD, Reason.NONE)
    assert state(rig) == AxisState.RUN
    assert rig.get("Dt") == 0.05  # since the last scan that was coasted
    assert (rig.get("Position"), rig.get("Velocity"), rig.get("K0")) == pytest.approx(
        (reference.y, reference.y_dot, reference.K0), rel=1e-9
    )


@pytest.mark.parametrize(("after", "status", "expected"), [
    ("hold", LAST, AxisState.HOLD),
    ("fail", S.BAD_SENSOR_FAILURE, AxisState.FAIL),
])  # fmt: skip
def test_a_coast_ends_after_its_time_and_does_not_come_back(after: Any, status: StatusCode, expected: AxisState):
    rig = running(replace(SPEC, on_bad="coast", coast_max=0.22, after_coast=after))
    for _ in range(4):
        rig.fail(S.BAD_SENSOR_FAILURE)
        assert state(rig) == AxisState.COAST
    last = rig.get("Position")
    for _ in range(3):
        rig.fail(S.BAD_SENSOR_FAILURE)
        assert rig.outcome() == (status, Reason.INPUT_BAD)
        assert state(rig) == expected
    if after == "hold":
        assert rig.get("Position") == last


def test_a_coast_ends_when_its_position_is_too_uncertain():
    rig = running(replace(SPEC, on_bad="coast", coast_max=60.0, coast_max_sigma=1.5))
    sigma, scans = math.sqrt(rig.get("P00")), 0
    while state(rig) != AxisState.FAIL:
        rig.scan(math.nan)
        scans += 1
        if state(rig) == AxisState.COAST:
            assert sigma < math.sqrt(rig.get("P00")) <= 1.5
    assert 5 < scans < 60
    assert rig.outcome() == (S.BAD_OUT_OF_RANGE, Reason.INPUT_NOT_FINITE)


def test_a_good_sample_within_the_coast_starts_its_time_anew():
    rig = running(replace(SPEC, on_bad="coast", coast_max=0.22), scans=400)
    for _ in range(5):
        for _ in range(4):
            rig.scan(math.nan)
            assert state(rig) == AxisState.COAST
        ramp(rig)
        assert rig.outcome() == (S.GOOD, Reason.NONE)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-6)  # a settled ramp is carried on exactly


def test_a_coast_may_be_longer_than_reinit_after_and_still_goes_on_from_where_it_is():
    rig = running(replace(SPEC, on_bad="coast", coast_max=5.0, reinit_after=0.3), scans=400)
    for _ in range(90):
        rig.scan(math.nan)
    ramp(rig)
    assert rig.outcome() == (S.GOOD, Reason.NONE)
    assert rig.get("Position") == pytest.approx(SPEED * (rig.now - 100.0), abs=1e-6)


def test_a_coast_that_ends_where_nobody_expects_it_settles_and_position_does_not_jump():
    rig = running(replace(SPEC, on_bad="coast", on_lost="coast", coast_max=5.0, reinit_samples=8), scans=400)
    for _ in range(50):
        rig.fail(S.BAD_NO_COMMUNICATION)
    shown = [rig.get("Position")]
    for _ in range(8):
        assert rig.outcome()[0] != S.GOOD
        ramp(rig, offset=300.0)
        shown.append(rig.get("Position"))
    assert rig.outcome() == (S.GOOD, Reason.NONE)
    steps = np.diff(shown)
    assert max(steps) < 300.0 / 8 + 10.0  # an eighth of the way, and what the estimate overshoots
    assert state(rig) == AxisState.RUN


def test_samples_in_time_after_late_ones_are_good_when_the_estimate_has_settled():
    rig = running()
    for _ in range(10):
        rig.scan(SPEED * (rig.next - 100.0 - 0.04), status=S.UNCERTAIN_LAST_USABLE_VALUE)  # asked for a scan before
        assert rig.outcome() == (S.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_UNCERTAIN)
    for _ in range(SPEC.reinit_samples - 1):
        ramp(rig)
        assert (rig.outcome(), state(rig)) == ((S.UNCERTAIN_INITIAL_VALUE, Reason.SETTLING), AxisState.RUN)
    ramp(rig)
    assert (rig.outcome(), state(rig)) == ((S.GOOD, Reason.NONE), AxisState.RUN)


@pytest.mark.parametrize("dt_source", ["scan", "source", "arrival", "nominal"])
def test_a_coast_leaves_time_right_whatever_it_is_measured_by(dt_source: Any):
    rig = running(replace(SPEC, on_bad="coast", dt_source=dt_source), scans=400)
    for _ in range(6):
        rig.scan(math.nan)
    for _ in range(5):
        ramp(rig)
        assert rig.get("Dt") == pytest.approx(0.05)
        assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-5)


def test_an_estimate_that_has_not_settled_does_not_coast():
    rig = make_rig((replace(SPEC, on_bad="coast", after_coast="hold"), CONFIG))
    ramp(rig)
    rig.scan(math.nan)
    assert state(rig) == AxisState.HOLD

    rig = running(replace(SPEC, on_bad="coast", on_lost="fail"))
    rig.fail(S.BAD_NO_COMMUNICATION)
    ramp(rig)
    assert state(rig) == AxisState.REINIT
    rig.scan(math.nan)
    assert state(rig) == AxisState.FAIL


def test_reset_ends_a_coast():
    rig = running(replace(SPEC, on_bad="coast", after_coast="hold", tuning_writable=True))
    rig.scan(math.nan)
    rig.observer.command(rig.table.index("A0.Reset"), 1.0)
    rig.scan(math.nan)
    assert state(rig) == AxisState.HOLD
    ramp(rig)
    assert (rig.outcome()[1], state(rig)) == (Reason.INITIALISING, AxisState.INIT)


@pytest.mark.parametrize("name", OBSERVERS)
def test_every_observer_coasts_at_its_velocity_and_goes_on(name: str):
    rig = running(replace(SPEC, on_bad="coast", on_lost="coast", coast_max=1.0), OBSERVERS[name], scans=400)
    start = rig.now
    position, velocity = rig.get("Position"), rig.get("Velocity")
    for k in range(10):
        rig.fail(S.BAD_NO_COMMUNICATION if k % 2 else S.BAD_SENSOR_FAILURE)
        assert (state(rig), rig.outcome()[0]) == (AxisState.COAST, LOST if k % 2 else LAST)
    if name != "fb_kalman as written":  # whose velocity swings on a ramp
        carried = position + velocity * (rig.now - start)
        # the adaptive one reckons with a stop: its velocity falls a little
        assert rig.get("Position") == pytest.approx(carried, rel=1e-3)
    ramp(rig)
    assert rig.outcome() == (S.GOOD, Reason.NONE)
    assert state(rig) == AxisState.RUN


def test_an_observer_of_past_samples_steps_with_all_the_time_since_the_last_one():
    rig = running(replace(SPEC, on_bad="coast", coast_max=5.0), FiniteDifferenceConfig(type="finite_difference"))
    for k in range(40):
        rig.scan(math.nan)
        assert rig.get("Dt") == pytest.approx(0.05 * (k + 1))
    ramp(rig, offset=-4.0)
    assert rig.get("Dt") == pytest.approx(41 * 0.05)
    assert rig.get("Velocity") == pytest.approx(SPEED - 4.0 / (41 * 0.05))
    assert rig.outcome() == (S.GOOD, Reason.NONE)


def test_a_scan_in_which_no_time_goes_by_leaves_a_coast_where_it_is():
    rig = running(replace(SPEC, on_bad="coast"))
    rig.scan(math.nan)
    before = [rig.get(leaf) for leaf in ("Position", "P00")]
    rig.scan(math.nan, dt=0.0)
    assert state(rig) == AxisState.COAST
    assert [rig.get(leaf) for leaf in ("Position", "P00")] == before


_POLICIES = st.sampled_from(["hold", "coast", "passthrough", "fail"])
_SPECS = st.builds(
    replace,
    st.just(SPEC),
    enable_writable=st.just(True),
    on_bad=_POLICIES,
    on_lost=_POLICIES,
    coast_max=st.sampled_from([0.1, 0.5, 5.0]),
    after_coast=st.sampled_from(["hold", "fail"]),
    reinit_samples=st.integers(1, 5),
    reinit_after=st.sampled_from([0.2, 1.0]),
    dt_source=st.sampled_from(["scan", "source", "arrival", "nominal"]),
    on_repeat=st.sampled_from(["update", "predict"]),
)


@pytest.mark.parametrize("name", OBSERVERS)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_good_means_running_and_finite_and_neighbours_change_nothing(name: str, data: st.DataObject):
    specs = data.draw(st.lists(_SPECS, min_size=3, max_size=3))
    specs = [replace(spec, name=f"A{axis}") for axis, spec in enumerate(specs)]
    rig = make_rig(*[(spec, OBSERVERS[name]) for spec in specs])
    alone = make_rig((replace(specs[1], name="A0"), OBSERVERS[name]))
    for fault in data.draw(st.lists(faults(3), max_size=25)):
        apply(rig, fault)
        apply(alone, replace(fault, z=fault.z[1:2]))
        for axis in range(3):
            status, _ = rig.outcome(axis)  # also: NaN means Bad
            assert status != S.GOOD or rig.get("State", axis) == AxisState.RUN
            assert not np.isinf(rig.get("Position", axis))
        first = [int(block.start) for one in (rig, alone) for block in one.table.blocks if block.name in ("A1", "A0")]
        width = len(alone.table) - first[-1]
        np.testing.assert_array_equal(
            rig.outputs.values[first[1] : first[1] + width], alone.outputs.values[first[-1] :]
        )


@pytest.mark.parametrize("cause", [Reason.STAMP_FROZEN, Reason.PROGRAM_STOPPED])
@pytest.mark.parametrize(
    ("on_lost", "status", "shown"),
    [
        ("fail", S.BAD_OUT_OF_SERVICE, AxisState.FAIL),
        ("hold", LOST, AxisState.HOLD),
        ("coast", LOST, AxisState.COAST),
    ],
)
def test_a_source_that_stands_still_for_long_is_as_one_that_is_lost(cause, on_lost, status, shown):
    rig = running(replace(SPEC, on_lost=on_lost))
    rig.inputs.causes[0] = cause
    rig.fail(S.BAD_OUT_OF_SERVICE)
    assert (rig.outcome(), state(rig)) == ((status, cause), shown)
    assert math.isnan(rig.get("Position")) == (shown == AxisState.FAIL)
