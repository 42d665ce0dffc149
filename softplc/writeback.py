"""When an output is written into a source PLC: on change or every n scans, rate-limited, Good values only."""

from collections import deque
from dataclasses import dataclass, field
from typing import Final

from softplc.exchange import DEAD_AFTER_AT_LEAST, DEAD_AFTER_PERIODS
from softplc.link import Link
from softplc.link_write import Written
from softplc.sample import StatusCode, WriteState, is_bad
from softplc.tags import Image
from softplc.timing import Scan

_GOOD: Final = int(StatusCode.GOOD)
_REMEMBERED: Final = 64  # answered writes, of which any may still be read back
_ASKED_AGAIN: Final = 1.0  # seconds until a value that was refused is written once more
_REAL: Final = 2.0**-23  # what a REAL loses of a value, at the most


@dataclass(slots=True)
class ReadBack:
    """The written tag as it is read along: its index in the inputs, and what counts as the same value.

    `tolerance` in the output's unit. `within`: seconds in which an older value may still be read back; one that was
    never written, or longer ago, is a mismatch.
    """

    index: int
    tolerance: float
    within: float
    _written: deque[Written] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))

    def note(self, written: Written) -> None:
        """The source took this value."""
        self._written.append(written)

    def forget(self) -> None:
        """The link was lost, or the output was not Good: what the source holds is not ours any more."""
        self._written.clear()

    def found(self, inputs: Image) -> float:
        """What was read back last."""
        return inputs.values.item(self.index)

    def judge(self, now: float, inputs: Image) -> WriteState:
        """Compare what was read in this scan with what was written lately."""
        status = inputs.statuses.item(self.index)
        if status != _GOOD:
            return WriteState.UNVERIFIED if is_bad(status) else WriteState.WAITING
        value = self.found(inputs)
        for written in reversed(self._written):
            if abs(value - written.value) <= self.tolerance + _REAL * abs(written.value):
                return WriteState.WRITTEN
            if now - written.at > self.within:
                return WriteState.MISMATCH
        return WriteState.MISMATCH if len(self._written) == _REMEMBERED else WriteState.WAITING


@dataclass(slots=True)
class WriteBack:
    """One output tag and where it goes. `min_interval` in seconds, `deadband` in the tag's unit.

    `name` for the log; `state` is the index of the tag that shows the worst WriteState of its axis. `judge`: index of
    the tag that has to be Good for this one to be written, the tag itself when left out.
    """

    index: int
    link: Link
    position: int
    deadband: float = 0.0
    every_scans: int | None = None
    min_interval: float = 0.0
    read_back: ReadBack | None = None
    name: str = ""
    state: int | None = None
    judge: int | None = None
    _last_value: float | None = None
    _last_time: float = float("-inf")
    _answer: Written | None = None
    _differs: bool = False

    def step(self, scan: Scan, inputs: Image, outputs: Image) -> WriteState:
        """Hand the value to the link when it is due; how the write-back is.

        What still waits to be written is withdrawn when the output is not Good any more, and takes the newest value
        with every scan while it is. After that, and after a reconnect, the next Good value is due; what was refused
        is due again after a second. A value is valid for as long as the scan that it comes from counts as alive.
        """
        writing = self.link.writing
        answer = writing.answers.get(self.position)
        if answer is not self._answer:
            self._answer = answer
            if self.read_back is not None and answer is not None and not is_bad(answer.status):
                self.read_back.note(answer)
        if not self.link.statistics.connected:
            self._start_anew()
            return WriteState.WITHHELD
        if outputs.statuses.item(self.index if self.judge is None else self.judge) != _GOOD:
            writing.withdraw(self.position)
            self._start_anew()
            return WriteState.WITHHELD
        waited = writing.waiting(self.position)
        value = outputs.values.item(self.index)
        if writing.pending(self.position) or self._due(scan, value):
            until = scan.start + max(DEAD_AFTER_PERIODS * scan.period, DEAD_AFTER_AT_LEAST)
            writing.put(self.position, value, until)
            self._last_value, self._last_time = value, scan.start
        return self._judge(scan, inputs, waited)

    def withdraw(self) -> None:
        """Nothing of this is written any more."""
        self.link.writing.withdraw(self.position)

    def _start_anew(self) -> None:
        self._last_value = None
        if self.read_back is not None:
            self.read_back.forget()

    def _due(self, scan: Scan, value: float) -> bool:
        if scan.start - self._last_time < self.min_interval:
            return False
        if self.every_scans is not None:
            return scan.number % self.every_scans == 0
        if self._last_value is None or abs(value - self._last_value) > self.deadband:
            return True
        refused = self._answer is not None and is_bad(self._answer.status)
        return refused and scan.start - self._last_time >= _ASKED_AGAIN

    def _judge(self, scan: Scan, inputs: Image, waited: bool) -> WriteState:
        if self._answer is None:
            return WriteState.WAITING if waited else WriteState.NONE
        if is_bad(self._answer.status):
            return WriteState.REFUSED
        state = WriteState.WRITTEN if self.read_back is None else self.read_back.judge(scan.start, inputs)
        self._tell(state, inputs)
        return WriteState.WAITING if waited and state is WriteState.WRITTEN else state

    def _tell(self, state: WriteState, inputs: Image) -> None:
        """One line when another value is read back than was written, one when that is over."""
        if self.read_back is None or self._answer is None:
            return
        if state is WriteState.MISMATCH and not self._differs:
            self._differs = True
            self.link.writing.mismatch(self.position, self._answer.value, self.read_back.found(inputs))
        elif state is WriteState.WRITTEN and self._differs:
            self._differs = False
            self.link.writing.match(self.position)
