"""The rules of docs/bad-inputs.md for one axis, scan by scan, as plain conditions: what must be published.

It shares nothing with the code that it judges; of the observer it knows how many samples a start takes.
"""

from dataclasses import dataclass
from typing import Final

from softplc.observers.axes import AxisSpec
from softplc.sample import AxisState, Reason, StatusCode

GOOD, UNCERTAIN, NAN, INFINITE, OUTSIDE, BAD, LOST = range(7)
"""What a sample may be."""

INPUT_STATUS: Final = {
    GOOD: StatusCode.GOOD,
    UNCERTAIN: StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE,
    NAN: StatusCode.GOOD,
    INFINITE: StatusCode.GOOD,
    OUTSIDE: StatusCode.GOOD,
    BAD: StatusCode.BAD_SENSOR_FAILURE,
    LOST: StatusCode.BAD_NO_COMMUNICATION,
}
_REASON: Final = {
    NAN: Reason.INPUT_NOT_FINITE,
    INFINITE: Reason.INPUT_NOT_FINITE,
    OUTSIDE: Reason.INPUT_OUT_OF_RANGE,
    BAD: Reason.INPUT_BAD,
    LOST: Reason.NO_COMMUNICATION,
}
FAR: Final = 25.0
"""NIS from which on a sample after a coast is not where the axis should be."""
Outcome = tuple[int, int, int]  # status, reason, state


@dataclass(slots=True)
class Oracle:
    """One axis. `warm`: samples from the start of the observer that are not Good yet."""

    spec: AxisSpec
    period: float
    warm: int = 1
    state: int = AxisState.INIT
    ran: bool = False
    values: bool = False
    gap: float = 0.0  # since the last sample that was used, or scan that was coasted
    samples: int = 0  # since the observer started; 0: it has not
    coasted: float = 0.0
    lost: bool = False
    wanted: int = 0  # fresh samples until the outputs may be Good

    def scan(self, kind: int, dt: float, nis: float) -> Outcome:
        """What the outputs must be after a scan that found this kind of sample, new in this scan.

        `nis` is the NIS that was published with it, NaN where there is none.
        """
        self.gap += dt
        self.lost |= self.state == AxisState.COAST and nis > FAR
        late = self.gap - self.period > self.spec.reinit_after
        if late:
            self.samples = 0
        outcome = self._used(kind, late) if kind in (GOOD, UNCERTAIN) else self._unusable(kind, dt)
        self.state = outcome[2]
        return outcome

    def _used(self, kind: int, late: bool) -> Outcome:
        self.samples += 1
        if self.ran and self.wanted == 0 and (self.lost or late):
            self.wanted = self.spec.reinit_samples
        self.wanted = max(self.wanted - 1, 0)
        self.gap, self.coasted, self.lost, self.values = 0.0, 0.0, False, True

        if self.samples <= self.warm:
            state = AxisState.REINIT if self.ran else AxisState.INIT
            return StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING, state
        state = AxisState.REINIT if self.wanted else AxisState.RUN
        self.ran |= state == AxisState.RUN
        if kind == UNCERTAIN:
            return INPUT_STATUS[UNCERTAIN], Reason.INPUT_UNCERTAIN, state
        if state == AxisState.REINIT:
            return StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.SETTLING, state
        return StatusCode.GOOD, Reason.NONE, state

    def _unusable(self, kind: int, dt: float) -> Outcome:
        spec, reason = self.spec, _REASON[kind]
        if self.wanted:
            self.wanted = spec.reinit_samples
        self.coasted += dt
        policy = spec.on_lost if kind == LOST else spec.on_bad
        if policy == "coast":
            running = self.state in (AxisState.RUN, AxisState.COAST) and self.samples > 0
            if running and self.coasted <= spec.coast_max:
                self.gap = 0.0
                return self._old(kind), reason, AxisState.COAST
            policy = spec.after_coast
        if kind == LOST:
            self.lost |= self.ran
        if policy == "passthrough" and kind == OUTSIDE:
            self.values = True
            return StatusCode.UNCERTAIN_SUB_NORMAL, Reason.PASSED_THROUGH, AxisState.PASSTHROUGH
        if policy == "hold" and self.values:
            if kind == OUTSIDE:
                return StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED, reason, AxisState.HOLD
            return self._old(kind), reason, AxisState.HOLD
        status = INPUT_STATUS[kind] if kind in (BAD, LOST) else StatusCode.BAD_OUT_OF_RANGE
        return status, reason, AxisState.FAIL if self.values else AxisState.INIT

    @staticmethod
    def _old(kind: int) -> StatusCode:
        if kind == LOST:
            return StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE
        return StatusCode.UNCERTAIN_LAST_USABLE_VALUE
