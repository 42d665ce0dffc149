"""Notifications of one subscription that wait to be published, as arrays of entries."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ENTRY: Final = np.dtype(
    {
        "names": ["slot", "handle", "class", "value", "status", "source", "server"],
        "formats": ["i4", "u4", "u1", "f8", "u4", "i8", "i8"],
    }
)
"""A notification: its item's slot, the client's handle, class as in `encoding`, and the sample; timestamps ns UTC."""
OVERFLOW: Final = np.uint32(0x480)
"""InfoType DataValue with the overflow bit (OPC 10000-4, 7.39)."""
_TRIMMED_FROM: Final = 4096

Entries = NDArray[Any]


class Queue:
    """Entries in the order they came, in `batches`.

    `size` and `oldest` are by slot: how many each keeps, and whether it drops the oldest.
    """

    def __init__(self) -> None:
        self.batches: list[Entries] = []
        self._count = 0
        self._overfull = False
        self._trim_at = _TRIMMED_FROM

    def __len__(self) -> int:
        return self._count

    def put(self, entries: Entries, overfull: bool, size: NDArray[np.int32], oldest: NDArray[np.bool_]) -> None:
        """Append; `overfull` when a slot now has more than it keeps. They are counted out now and then."""
        self.batches.append(entries)
        self._count += len(entries)
        self._overfull |= overfull
        if self._overfull and self._count >= self._trim_at:
            self._trim(size, oldest)
            self._trim_at = max(2 * self._count, _TRIMMED_FROM)

    def take(self, most: int, size: NDArray[np.int32], oldest: NDArray[np.bool_]) -> Entries:
        """The first `most` of those that are kept; they are then gone from here."""
        if self._overfull:
            self._trim(size, oldest)
        whole = self._join()
        self._set(whole[most:])
        self._trim_at = _TRIMMED_FROM
        return whole[:most]

    def pull(self, slots: NDArray[np.intp]) -> Entries:
        """What the items of these slots had to say; it is then gone from here."""
        if not self._count:
            return np.empty(0, ENTRY)
        whole = self._join()
        which = np.isin(whole["slot"], slots)
        self._set(whole[~which])
        return whole[which]

    def overfill(self) -> None:
        """A slot has more than it keeps from now on."""
        self._overfull = True

    def _trim(self, size: NDArray[np.int32], oldest: NDArray[np.bool_]) -> None:
        self._set(keep(self._join(), size, oldest))
        self._overfull = False

    def _join(self) -> Entries:
        if len(self.batches) == 1:
            return self.batches[0]
        return np.concatenate(self.batches) if self.batches else np.empty(0, ENTRY)

    def _set(self, entries: Entries) -> None:
        self.batches = [entries] if len(entries) else []
        self._count = len(entries)


def keep(entries: Entries, size: NDArray[np.int32], oldest: NDArray[np.bool_]) -> Entries:
    """As many entries of each slot as it keeps, in their order (OPC 10000-4, 7.21, queueSize and discardOldest).

    A slot that lost some and keeps more than one says so: with the overflow bit in its first entry where the oldest
    are discarded, else in its last, which took the place of the one before.
    """
    slots = entries["slot"]
    order = np.argsort(slots, kind="stable")
    ordered = slots[order]
    begins = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
    counts = np.diff(np.r_[begins, len(ordered)])
    rank = np.arange(len(ordered)) - np.repeat(begins, counts)
    count, room, discards = np.repeat(counts, counts), size[ordered], oldest[ordered]
    lost = count > room
    stays = np.where(discards, rank >= count - room, (rank < room - 1) | (rank == count - 1))
    marked = lost & (room > 1) & (rank == np.where(discards, count - room, count - 1))
    kept = entries.copy()
    kept["status"][order[marked]] |= OVERFLOW
    which = np.zeros(len(entries), np.bool_)
    which[order[stays]] = True
    return kept[which]
