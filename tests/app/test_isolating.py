"""One axis of a hundred fails: it is parked, the others go on; restarts are few, and then none."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import structlog

from softplc.app.isolating import JOINED, PAUSE, RESTARTS, WITHIN, IsolatingObserver
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisPlace, AxisSpec
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.observer import AxisObserver
from softplc.observers.signal_config import SignalSpec
from softplc.sample import AxisState, Reason, StatusCode
from tests.observers.rig import Rig, make_rig

N = 100
SETTLED = 3
POISON = 666.0  # the measurement at which the kernel raises


@pytest.fixture(autouse=True)
def lines() -> Iterator[list[Any]]:
    """The log; nothing is printed."""
    with structlog.testing.capture_logs() as captured:
        yield captured


@dataclass
class Faults:
    """What makes a kernel raise: a measurement, or `lurking` fails the next step of this axis' first observer."""

    lurking: set[int] = field(default_factory=set)
    built: int = 0

    def build(self, places: Sequence[AxisPlace], configs: Sequence[Any]) -> AxisObserver:
        self.built += 1
        observer = type(configs[0]).build(places, configs)
        kernel, axes = observer._kernel, [int(place.spec.name[1:]) for place in places]
        step, first = kernel.step, self.built == 1

        def failing(given: Any) -> Any:
            results = step(given)  # the state is half a scan further when it raises
            if (given.z == POISON).any() or (first and self.lurking & set(axes)):
                raise ZeroDivisionError("integer modulo by zero")
            return results

        kernel.step = failing
        return observer


def rig_of(faults: Faults, config: Any, n: int = N, **spec: Any) -> Rig:
    rig = make_rig(*[(AxisSpec(f"A{axis}", **spec), config) for axis in range(n)])
    places = [
        AxisPlace(AxisSpec(block.name, **spec), axis, None, block)
        for axis, block in enumerate(block for block in rig.table.blocks if block.kind == "axis")
    ]
    rig.observer = IsolatingObserver(places, [config] * n, faults.build)
    return rig


def ramp(rig: Rig, scans: int, n: int = N, *poisoned: int) -> None:
    for _ in range(scans):
        z = 10.0 * rig.next + np.arange(float(n))
        z[list(poisoned)] = POISON
        rig.scan(*z)


OBSERVERS = {
    "aoi": AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3),
    "cv_accel": CvAccelConfig(type="cv_accel", r_x=1.0),
    "alpha_beta": AlphaBetaConfig(type="alpha_beta", alpha=0.4),
}


def test_a_counter_stays_in_its_turn_when_its_observer_starts_anew():
    faults = Faults()
    rig = rig_of(faults, OBSERVERS["aoi"], 2, signal=SignalSpec(counter=100.0))
    for k in range(60):
        if k == 30:  # in the scan in which the counters roll over
            faults.lurking.add(0)
        rig.scan(*((10.0 * k + axis) % 100.0 for axis in range(2)))
    assert faults.built > 1
    for axis in range(2):
        assert rig.outcome(axis) == (StatusCode.GOOD, Reason.NONE)
        assert rig.get("Position", axis) == pytest.approx(590.0 + axis, abs=5.0)


@pytest.mark.parametrize("name", OBSERVERS)
def test_one_axis_of_a_hundred_raises_and_the_others_are_good_again_after_they_have_settled(name: str):
    faults = Faults()
    rig = rig_of(faults, OBSERVERS[name])
    twin = make_rig(*[(AxisSpec(f"A{axis}"), OBSERVERS[name]) for axis in range(N)])
    for one in (rig, twin):
        ramp(one, 40)

    ramp(rig, 1, N, 57)
    ramp(twin, 1)
    assert rig.outcome(57) == (StatusCode.BAD_INTERNAL_ERROR, Reason.INTERNAL_ERROR)
    assert rig.get("State", 57) == AxisState.PARKED
    others = [axis for axis in range(N) if axis != 57]
    for axis in others:
        assert rig.outcome(axis)[0] == StatusCode.UNCERTAIN_INITIAL_VALUE
        assert rig.get("State", axis) == AxisState.REINIT
        # bumpless: between where it was and where the other is now, a third of the way
        assert abs(rig.get("Position", axis) - twin.get("Position", axis)) < 10.0 * 0.05

    for _ in range(SETTLED - 1):
        ramp(rig, 1, N, 57)
    for axis in others:
        assert rig.outcome(axis) == (StatusCode.GOOD, Reason.NONE)
    assert faults.built < 3 * 2 * np.ceil(np.log2(N))  # halves, not a hundred

    ramp(rig, 300, N, 57)
    ramp(twin, 302)
    for axis in others:  # the filters have forgotten where they started: rounding alone
        assert rig.get("Position", axis) == pytest.approx(twin.get("Position", axis), abs=1e-6)
        assert rig.get("Velocity", axis) == pytest.approx(twin.get("Velocity", axis), abs=1e-6)


def test_a_parked_axis_is_restarted_after_a_pause_and_settles():
    rig = rig_of(Faults(), OBSERVERS["aoi"], 8)
    ramp(rig, 10, 8)
    ramp(rig, 1, 8, 3)
    pause = round(PAUSE / rig.period)

    ramp(rig, pause - 2, 8)
    assert rig.outcome(3) == (StatusCode.BAD_INTERNAL_ERROR, Reason.INTERNAL_ERROR)
    assert rig.status("Raw", 3) == StatusCode.UNCERTAIN_LAST_USABLE_VALUE  # nobody reads it on
    waited = (pause - 1) * rig.period  # since the sample before the one that made it raise
    assert rig.get("Age", 3) == pytest.approx(waited, abs=1e-9)
    assert rig.stamp("State", 3) == rig.stamp("State", 0)
    ramp(rig, 3, 8)
    assert rig.get("State", 3) == AxisState.REINIT
    ramp(rig, SETTLED, 8)
    assert rig.outcome(3) == (StatusCode.GOOD, Reason.NONE)
    assert rig.status("Raw", 3) == StatusCode.GOOD
    assert [rig.outcome(axis)[0] for axis in range(8)] == [StatusCode.GOOD] * 8


def test_an_axis_that_fails_again_and_again_is_restarted_three_times_and_then_parked_for_good(lines: list[Any]):
    rig = rig_of(Faults(), OBSERVERS["aoi"], 4)
    ramp(rig, 10, 4)
    ramp(rig, round(30.0 / rig.period), 4, 2)

    restarts = [line for line in lines if line["event"] == "axis restarted"]
    parked = [line["restart_in"] for line in lines if line["event"] == "axis parked"]
    assert [line["axis"] for line in restarts] == ["A2"] * RESTARTS
    assert parked == [PAUSE] * RESTARTS + ["never"]

    ramp(rig, round(60.0 / rig.period), 4)  # the poison is gone: it stays where it is
    assert rig.outcome(2) == (StatusCode.BAD_INTERNAL_ERROR, Reason.INTERNAL_ERROR)
    assert [rig.outcome(axis)[0] for axis in (0, 1, 3)] == [StatusCode.GOOD] * 3
    assert not rig.observer.command(rig.table.index("A2.Reset"), 1.0)


def test_several_axes_may_fail_in_one_scan():
    rig = rig_of(Faults(), OBSERVERS["aoi"], 16)
    ramp(rig, 10, 16)
    ramp(rig, SETTLED, 16, 0, 7, 8, 15)
    for axis in range(16):
        status = StatusCode.BAD_INTERNAL_ERROR if axis in (0, 7, 8, 15) else StatusCode.GOOD
        assert rig.outcome(axis)[0] == status


def test_a_failure_that_nobody_repeats_costs_no_axis():
    """Nobody raises alone: it was a state that is gone. All of them settle, none is parked."""
    faults = Faults()
    rig = rig_of(faults, OBSERVERS["aoi"], 8)
    ramp(rig, 10, 8)
    faults.lurking.add(5)
    ramp(rig, 1, 8)
    assert [rig.get("State", axis) for axis in range(8)] == [AxisState.REINIT] * 8
    ramp(rig, SETTLED, 8)
    assert [rig.outcome(axis) for axis in range(8)] == [(StatusCode.GOOD, Reason.NONE)] * 8


def test_every_axis_may_fail_and_the_scan_goes_on():
    rig = rig_of(Faults(), OBSERVERS["aoi"], 5)
    ramp(rig, 3, 5)
    ramp(rig, 3, 5, *range(5))
    assert {rig.outcome(axis) for axis in range(5)} == {(StatusCode.BAD_INTERNAL_ERROR, Reason.INTERNAL_ERROR)}


def test_what_clients_have_written_outlives_the_failure_of_a_neighbour():
    config = OBSERVERS["aoi"]
    rig = rig_of(Faults(), config, 4, enable_writable=True, tuning_writable=True)
    ramp(rig, 10, 4)
    assert rig.observer.command(rig.table.index("A1.Enable"), 0.0)
    assert rig.observer.command(rig.table.index("A2.r_x"), 9.0)
    ramp(rig, 1, 4)

    ramp(rig, 2, 4, 3)

    assert (rig.get("Enabled", 1), rig.get("State", 1)) == (0.0, AxisState.DISABLED)
    assert rig.get("r_x", 2) == 9.0
    assert rig.get("Skipped", 2) == 0.0
    assert rig.observer.command(rig.table.index("A3.Enable"), 0.0)  # for the restart
    ramp(rig, round(PAUSE / rig.period) + 1, 4)
    assert rig.get("State", 3) == AxisState.DISABLED


def test_an_axis_without_a_sample_holds_what_it_had_when_its_neighbour_fails():
    rig = rig_of(Faults(), OBSERVERS["aoi"], 2)
    ramp(rig, 40, 2)
    before = [rig.get(leaf, 0) for leaf in ("Position", "Velocity", "P00")]
    stamp = rig.stamp("Position", 0)
    rig.scan(np.nan, POISON)
    assert rig.outcome(0) == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_NOT_FINITE)
    assert [rig.get(leaf, 0) for leaf in ("Position", "Velocity", "P00")] == before
    assert rig.stamp("Position", 0) == stamp


def test_axes_that_were_stepped_apart_are_stepped_as_one_again_after_a_quiet_minute_and_none_notices(
    lines: list[Any],
):
    """A state that was gone, then an axis that is restarted: three groups, and a twin that keeps them."""
    rigs = []
    for joining in (True, False):
        faults = Faults()
        rig = rig_of(faults, OBSERVERS["aoi"], 8)
        if not joining:
            rig.observer._join = lambda scan: None
        ramp(rig, 10, 8)
        faults.lurking.add(5)
        ramp(rig, 1, 8)
        faults.lurking.clear()
        ramp(rig, 10, 8)
        ramp(rig, 1, 8, 2)
        ramp(rig, round(PAUSE / rig.period) + 2, 8)
        assert sorted(len(group.axes) for group in rig.observer._groups) == [1, 3, 4]
        ramp(rig, round(WITHIN / rig.period), 8)
        rigs.append(rig)
    one, twin = rigs
    assert [sorted(group.axes) for group in one.observer._groups] == [list(range(8))]
    assert len(twin.observer._groups) == 3
    assert [line["axes"] for line in lines if line["event"] == "observers joined"]
    for _ in range(100):
        ramp(one, 1, 8)
        ramp(twin, 1, 8)
        for kind in ("values", "statuses", "source_timestamps"):
            np.testing.assert_array_equal(getattr(one.outputs, kind), getattr(twin.outputs, kind))
    ramp(one, SETTLED, 8, 6)  # and they fail as they did before
    assert one.outcome(6) == (StatusCode.BAD_INTERNAL_ERROR, Reason.INTERNAL_ERROR)
    assert [one.outcome(axis)[0] for axis in (0, 5, 7)] == [StatusCode.GOOD] * 3


def test_more_axes_than_a_scan_has_time_to_build_are_not_joined():
    faults = Faults()
    rig = rig_of(faults, OBSERVERS["alpha_beta"], JOINED + 20)
    ramp(rig, 3, JOINED + 20)
    faults.lurking.add(1)
    ramp(rig, round(WITHIN / rig.period) + 10, JOINED + 20)
    assert sorted(len(group.axes) for group in rig.observer._groups) == [60, 60]
