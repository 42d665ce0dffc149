"""When outputs are written into source PLCs: on change or every n scans, rate-limited, Good values only.

All write-backs of a task are stepped in arrays; what is Python for each one is what happens rarely: a defect, a line
in the log.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import structlog
from numpy.typing import NDArray

from softplc.exchange import DEAD_AFTER_AT_LEAST, DEAD_AFTER_PERIODS
from softplc.link import Link
from softplc.link_write import Slots
from softplc.read_back import Numbers, ReadBack, ReadBacks, Rows
from softplc.sample import StatusCode, WriteState
from softplc.tags import Image
from softplc.timing import Scan

_GOOD: Final = np.uint32(StatusCode.GOOD)
_BAD: Final = np.uint32(StatusCode.BAD)
_ASKED_AGAIN: Final = 1.0  # seconds until a value that was refused is written once more

Flags = NDArray[np.bool_]
States = NDArray[np.uint8]

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
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


class WriteBacks:
    """All write-backs of one task. Arrays[n].

    One that raises is parked, and writes nothing any more; the others go on. The slots of all links are in one run,
    so that a scan looks at all of them at once.
    """

    def __init__(self, write_backs: Sequence[WriteBack], task: str = "") -> None:
        n = len(write_backs)
        self._write_backs, self._task = write_backs, task
        self._links = list(dict.fromkeys(one.link for one in write_backs))
        number = {link: number for number, link in enumerate(self._links)}
        self._link = np.array([number[one.link] for one in write_backs], np.intp)
        ends = np.cumsum([len(link.writing) for link in self._links], dtype=np.intp)
        self._slots = Slots(ends[-1] if n else 0)
        starts = [0, *ends[:-1].tolist()]
        for link, start, stop in zip(self._links, starts, ends.tolist(), strict=False):
            link.writing.slots = self._slots.part(start, stop)
        self._positions = np.array([starts[number[one.link]] + one.position for one in write_backs], np.intp)

        self._indices = np.array([one.index for one in write_backs], np.intp)
        self._judges = np.array([one.index if one.judge is None else one.judge for one in write_backs], np.intp)
        self._deadbands = np.array([one.deadband for one in write_backs])
        self._every = np.array([one.every_scans or 0 for one in write_backs], np.int64)  # 0: on change
        self._intervals = np.array([one.min_interval for one in write_backs])
        self._read_backs = ReadBacks([one.read_back for one in write_backs if one.read_back is not None])
        self._verified: Flags = np.array([one.read_back is not None for one in write_backs], np.bool_)
        self._read_back = np.cumsum(self._verified) - 1  # which of the read-backs, where it is one
        shown = np.array([-1 if one.state is None else one.state for one in write_backs], np.intp)
        self._order = np.argsort(shown, kind="stable")  # the write-backs of an axis side by side
        self._shown, self._firsts = np.unique(shown[self._order], return_index=True)

        self._rows: Rows = np.arange(n)  # that are stepped: all but those that are parked
        self._states: States = np.zeros(n, np.uint8)
        self._last_values = np.zeros(n)
        self._last_times = np.full(n, -np.inf)
        self._anew: Flags = np.ones(n, np.bool_)  # due with its next Good value
        self._answers = np.zeros(n, np.int64)  # that were noticed
        self._differs: Flags = np.zeros(n, np.bool_)  # a mismatch that was told

    def step(self, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Hand what is due to the links; each axis shows the worst of its write-backs."""
        if self._rows.size:
            self._step(self._rows, scan, inputs, outputs)
        if self._order.size:
            worst = np.maximum.reduceat(self._states[self._order], self._firsts)
            shown = self._shown >= 0
            outputs.values[self._shown[shown]] = worst[shown]
            outputs.statuses[self._shown[shown]] = _GOOD
            outputs.source_timestamps[self._shown[shown]] = scan.timestamp

    def _step(self, rows: Rows, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Step these; when they raise, halves of them, down to those that raise alone."""
        try:
            self._step_rows(rows, scan, inputs, outputs)
        except Exception:  # a write-back's defect must not end the scan
            if len(rows) == 1:
                log.exception("write-back parked", task=self._task, write_back=self._write_backs[rows[0]].name)
                self._rows = self._rows[self._rows != rows[0]]
                self._states[rows] = WriteState.PARKED
                self._slots.pending[self._positions[rows]] = False
            else:
                self._step(rows[: len(rows) // 2], scan, inputs, outputs)
                self._step(rows[len(rows) // 2 :], scan, inputs, outputs)

    @np.errstate(all="ignore")
    def _step_rows(self, rows: Rows, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Hand these values to their links where they are due.

        What still waits to be written is withdrawn when the output is not Good any more, and takes the newest value
        with every scan while it is. After that, and after a reconnect, the next Good value is due; what was refused
        is due again after a second. A value is valid for as long as the scan that it comes from counts as alive.
        """
        slots = self._slots
        self._take_answers(rows)
        connected = np.array([link.statistics.connected for link in self._links])[self._link[rows]]
        good = connected & (outputs.statuses[self._judges[rows]] == _GOOD)
        if not good.all():
            slots.pending[self._positions[rows[connected & ~good]]] = False
            self._withhold(rows[~good])
            rows = rows[good]
        positions, values = self._positions[rows], outputs.values[self._indices[rows]]
        waited = slots.pending[positions] | slots.under_way[positions]
        due = slots.pending[positions] | self._due(rows, scan, values)
        until = scan.start + max(DEAD_AFTER_PERIODS * scan.period, DEAD_AFTER_AT_LEAST)
        slots.put(positions[due], values[due], until)
        self._last_values[rows[due]], self._last_times[rows[due]] = values[due], scan.start
        self._anew[rows[due]] = False
        self._judge(rows, scan, inputs, waited)

    def _take_answers(self, rows: Rows) -> None:
        """Remember what the sources took since the last scan, for it may be read back."""
        slots, positions = self._slots, self._positions[rows]
        answered = slots.answers[positions] != self._answers[rows]
        taken = answered & self._verified[rows] & (slots.statuses[positions] < _BAD)
        if taken.any():
            where = positions[taken]
            self._read_backs.note(self._read_back[rows[taken]], slots.answered[where], slots.times[where])
        self._answers[rows] = slots.answers[positions]

    def _withhold(self, rows: Rows) -> None:
        self._states[rows] = WriteState.WITHHELD
        self._anew[rows] = True
        self._read_backs.forget(self._read_back[rows[self._verified[rows]]])

    def _due(self, rows: Rows, scan: Scan, values: Numbers) -> Flags:
        since, every = scan.start - self._last_times[rows], self._every[rows]
        moved = self._anew[rows] | (np.abs(values - self._last_values[rows]) > self._deadbands[rows])
        refused = self._refused(rows) & (since >= _ASKED_AGAIN)
        wanted = np.where(every > 0, scan.number % np.maximum(every, 1) == 0, moved | refused)
        return wanted & (since >= self._intervals[rows])

    def _refused(self, rows: Rows) -> Flags:
        refused: Flags = self._slots.statuses[self._positions[rows]] >= _BAD
        return refused

    def _judge(self, rows: Rows, scan: Scan, inputs: Image, waited: Flags) -> None:
        """The states of those that are not withheld; `waited`: for the source's answer, before this scan."""
        answered, refused = self._answers[rows] > 0, self._refused(rows)
        states = np.where(answered, WriteState.WRITTEN, WriteState.NONE).astype(np.uint8)
        checked = np.flatnonzero(answered & ~refused & self._verified[rows])
        if checked.size:
            states[checked] = self._read_backs.judge(self._read_back[rows[checked]], scan.start, inputs)
            self._tell(rows[checked], states[checked], inputs)
        states[waited & (states <= WriteState.WRITTEN)] = WriteState.WAITING
        states[refused] = WriteState.REFUSED
        self._states[rows] = states

    def _tell(self, rows: Rows, states: States, inputs: Image) -> None:
        """One line when another value is read back than was written, one when that is over."""
        for row in rows[(states == WriteState.MISMATCH) & ~self._differs[rows]]:
            one, found = self._write_backs[row], self._read_backs.found(self._read_back[row], inputs)
            one.link.writing.mismatch(one.position, self._slots.answered.item(self._positions[row]), found)
        for row in rows[(states == WriteState.WRITTEN) & self._differs[rows]]:
            one = self._write_backs[row]
            one.link.writing.match(one.position)
        self._differs[rows] |= states == WriteState.MISMATCH
        self._differs[rows] &= states != WriteState.WRITTEN
