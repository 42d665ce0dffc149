"""What the gateway serves: read-only arrays over all tags, of which only what changed is copied."""

import sys
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softplc.sample import StatusCode
from softplc.tags import NO_TIMESTAMP, TagTable
from softplc.timing import Scan

_KEPT: Final = 4  # sheets: the newest, the one before, which servers compare with, one to fill and one to spare


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The newest finished scans as the gateway sees them; arrays run over all tags and are read-only.

    `scans` has each section's newest scan, None before the first; `alive` is False where the task stopped
    scanning: its tags are then NaN and BadNoCommunication. `version` grows when anything changed.
    """

    version: int
    values: NDArray[np.float64]
    statuses: NDArray[np.uint32]
    source_timestamps: NDArray[np.int64]
    scans: tuple[Scan | None, ...]
    alive: tuple[bool, ...]


class Sheet:
    """The arrays of one snapshot. `holds` has the number of the state that each section has here, -1 for none."""

    def __init__(self, table: TagTable) -> None:
        n = len(table)  # as a new Image: waits for its first data
        self.values: NDArray[np.float64] = np.full(n, np.nan)
        self.statuses: NDArray[np.uint32] = np.full(n, StatusCode.BAD_WAITING_FOR_INITIAL_DATA, np.uint32)
        self.source_timestamps: NDArray[np.int64] = np.full(n, NO_TIMESTAMP, np.int64)
        self.holds = [0] * len(table.sections)
        self._references = self._count()

    def frozen(self) -> tuple[NDArray[np.float64], NDArray[np.uint32], NDArray[np.int64]]:
        """Values, statuses and source timestamps, read-only and not copied."""
        return _frozen(self.values), _frozen(self.statuses), _frozen(self.source_timestamps)

    def is_held(self) -> bool:
        """Somebody still has one of the arrays, or a part of one: every view refers to the array that it is of."""
        return self._count() != self._references

    def _count(self) -> int:
        return sys.getrefcount(self.values) + sys.getrefcount(self.statuses) + sys.getrefcount(self.source_timestamps)


class Sheets:
    """Sheets in turns: what changes goes into one that nobody holds, the rest is copied there from the newest.

    A section's states are numbered, so that a sheet that has one already is spared its copy. New memory costs more
    than to copy into it: a sheet is used again when the last reader let go of it.
    """

    def __init__(self, table: TagTable) -> None:
        self._table = table
        self._states = [0] * len(table.sections)
        self._newest = Sheet(table)
        self._next: Sheet | None = None
        self._sheets = [self._newest]

    def fill(self, section: int) -> Sheet:
        """The sheet to write this section's new state into; it has none until it is `filled`."""
        sheet = self._next = self._next or self._spare()
        sheet.holds[section] = -1
        return sheet

    def change(self, section: int) -> Sheet:
        """The sheet to change this section's newest state in; then it is `filled`."""
        sheet = self._next = self._next or self._spare()
        self._bring(sheet, section)
        return sheet

    def filled(self, section: int) -> None:
        """The section's state in the sheet is its newest."""
        if self._next is not None:
            self._states[section] += 1
            self._next.holds[section] = self._states[section]

    def newest(self) -> Sheet:
        """The sheet with the newest state of every section; it is not written again while somebody holds it."""
        if self._next is not None:
            for section in range(len(self._states)):
                self._bring(self._next, section)
            self._newest, self._next = self._next, None
        return self._newest

    def _bring(self, sheet: Sheet, section: int) -> None:
        if sheet.holds[section] != self._states[section]:
            _, start, stop = self._table.sections[section]
            sheet.values[start:stop] = self._newest.values[start:stop]
            sheet.statuses[start:stop] = self._newest.statuses[start:stop]
            sheet.source_timestamps[start:stop] = self._newest.source_timestamps[start:stop]
            sheet.holds[section] = self._states[section]

    def _spare(self) -> Sheet:
        for sheet in self._sheets:
            if sheet is not self._newest and not sheet.is_held():
                return sheet
        sheet = Sheet(self._table)
        self._sheets = [*self._sheets[1 - _KEPT :], sheet]
        return sheet


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    view = array.view()
    view.flags.writeable = False
    return view
