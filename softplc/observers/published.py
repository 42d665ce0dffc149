"""The published tags of a group of axes as arrays, and their way into the outputs."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.observers.axes import AxisPlace
from softplc.observers.judgement import Judgement
from softplc.observers.leaves import COMMANDS, CONSTANTS, JUDGED, STATE
from softplc.sample import AxisState, Reason, StatusCode
from softplc.tags import Block, Image, Role
from softplc.timing import Scan

_EACH_SCAN: Final = ("Age", "State", "Quality", "Reason", "Enabled", "Consistency")  # carry the scan's own time


class Published:
    """Values, statuses and stamps of every tag as arrays[tags, axes], and where they lie in the outputs.

    Estimates carry the status of the axis, Raw that of its sample; `tell` gives the judged leaves theirs. All others
    are always Good. Raises ValueError when the blocks of the axes differ in their tags.
    """

    def __init__(self, places: Sequence[AxisPlace]) -> None:
        blocks = [place.block for place in places]
        leaves = _leaves(blocks[0])
        for block in blocks:
            if _leaves(block) != leaves:
                raise ValueError(
                    f"axes of one observer must have the same tags: {blocks[0].name} and {block.name} differ"
                )
        shape = (len(leaves), len(blocks))
        self._rows = {leaf: row for row, leaf in enumerate(leaves)}
        self.tuning = tuple(
            leaf
            for tag, leaf in zip(blocks[0].tags, leaves, strict=True)
            if tag.role is Role.TUNING and leaf not in COMMANDS
        )
        self._commands = [row for leaf, row in self._rows.items() if leaf in COMMANDS]
        others = {"Raw", *STATE, *CONSTANTS, *JUDGED, *self.tuning}
        self._estimates = np.array([row for leaf, row in self._rows.items() if leaf not in others], np.intp)
        self._judged = self.rows(*(leaf for leaf in JUDGED if leaf in self._rows))
        self._each_scan = self.rows(*(leaf for leaf in _EACH_SCAN if leaf in self._rows))
        starts = np.array([block.start for block in blocks], np.intp)
        self._index = starts[np.newaxis, :] + np.arange(len(leaves))[:, np.newaxis]
        adjacent = bool((np.diff(starts) == len(leaves)).all())
        self._run = slice(blocks[0].start, blocks[-1].stop) if adjacent else None
        self._values = np.zeros(shape)
        self._statuses = np.full(shape, StatusCode.GOOD, np.uint32)
        self._stamps = np.zeros(shape, np.int64)
        self._shown = np.zeros((len(self._commands), len(blocks)))
        self._first = True
        self._retuned: list[tuple[int, int]] = []

    @property
    def ages(self) -> NDArray[np.intp]:
        """Where each axis' Age lies in the outputs."""
        ages: NDArray[np.intp] = self._index[self._rows["Age"]]
        return ages

    @property
    def of_each_scan(self) -> NDArray[np.intp]:
        """Where all those tags lie that carry the time of the scan."""
        return self._index[self._each_scan].ravel()

    def __contains__(self, leaf: str) -> bool:
        return leaf in self._rows

    def row(self, leaf: str) -> NDArray[np.float64]:
        """The values of one tag of every axis; they stay until they are overwritten."""
        values: NDArray[np.float64] = self._values[self._rows[leaf]]
        return values

    def rows(self, *leaves: str) -> NDArray[np.intp]:
        """Row numbers of these tags, for `tell`."""
        return np.array([self._rows[leaf] for leaf in leaves], np.intp)

    def tell(self, rows: NDArray[np.intp], status: NDArray[np.uint32]) -> None:
        """Statuses[axes] of judged tags; their values are NaN where it is Bad."""
        self._statuses[rows] = status

    def adopt(self, other: "Published", axes: NDArray[np.intp]) -> None:
        """The estimates of these axes of another group of the same tags."""
        self._values[self._estimates] = other._values[self._estimates][:, axes]

    def retuned(self, leaf: str, axis: int, value: float) -> None:
        """A tuning tag shows another value from the next `write` on."""
        self.row(leaf)[axis] = value
        self._retuned.append((self._rows[leaf], axis))

    def write(self, scan: Scan, outputs: Image, samples: Judgement, timestamps: NDArray[np.int64]) -> None:
        """Copy everything into the outputs; estimates of axes without a value become NaN there, not here."""
        rows, values = self._rows, self._values
        self._statuses[self._estimates] = samples.status
        self._statuses[rows["Raw"]] = samples.raw_status
        self._stamps[self._estimates] = timestamps
        self._stamps[self._judged] = timestamps
        self._stamps[rows["Raw"]] = samples.timestamps
        self._stamps[self._each_scan] = scan.timestamp
        self._stamp_changes(scan)

        if samples.blank is not None and samples.blank.any():
            values = values.copy()
            values[np.ix_(self._estimates, np.flatnonzero(samples.blank))] = np.nan
        for image, own in (
            (outputs.values, values),
            (outputs.statuses, self._statuses),
            (outputs.source_timestamps, self._stamps),
        ):
            if self._run is None:
                image[self._index] = own
            else:
                image[self._run].reshape(own.shape[::-1])[:] = own.T

    def _stamp_changes(self, scan: Scan) -> None:
        """Constants, commands and tuning carry the time since when they are as they are."""
        commanded = self._values[self._commands]
        if self._first:
            self._stamps[self._commands] = scan.timestamp
            for leaf in (*CONSTANTS, *self.tuning):
                if leaf in self._rows:
                    self._stamps[self._rows[leaf]] = scan.timestamp
            self._first = False
        elif not np.array_equal(commanded, self._shown):
            row, axis = np.nonzero(commanded != self._shown)
            self._stamps[np.array(self._commands)[row], axis] = scan.timestamp
        self._shown[:] = commanded
        for changed in self._retuned:
            self._stamps[changed] = scan.timestamp
        self._retuned.clear()

    def park(self, outputs: Image) -> None:
        """Mark estimates and judged tags in the outputs, and say why; what was read last is not Good any more."""
        lost = self._index[np.concatenate([self._estimates, self._judged])]
        outputs.values[lost] = np.nan
        outputs.statuses[lost] = StatusCode.BAD_INTERNAL_ERROR
        raw = self._index[self._rows["Raw"]]
        good = raw[outputs.statuses[raw] < np.uint32(StatusCode.UNCERTAIN)]
        outputs.statuses[good] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE
        for leaf, value in (
            ("Quality", 0),
            ("Reason", Reason.INTERNAL_ERROR),
            ("State", AxisState.PARKED),
            ("Enabled", 0),
            ("Consistency", 0),
        ):
            if leaf in self._rows:
                outputs.values[self._index[self._rows[leaf]]] = value
                outputs.statuses[self._index[self._rows[leaf]]] = StatusCode.GOOD


def _leaves(block: Block) -> list[str]:
    return [tag.name.rpartition(".")[2] for tag in block.tags]
