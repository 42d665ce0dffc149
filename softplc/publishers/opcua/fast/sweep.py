"""Every monitored item on a tag's value, looked at in one sweep over arrays."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.publishers.opcua.fast.encoding import canonical, classes_of, with_timestamps
from softplc.publishers.opcua.fast.queue import ENTRY, Entries, Queue
from softplc.publishers.opcua.values import TagValues, Watch

_FIRST: Final = 256
NO_BAND: Final = -1.0


@dataclass(frozen=True, slots=True)
class Terms:
    """What a client wants of an item: `band` NO_BAND without one, `interval` seconds or 0 for each publish.

    `valued`: a change of the value is told; `stamped`: a new source timestamp alone, too.
    """

    handle: int
    stamps: int
    valued: bool
    stamped: bool
    band: float
    interval: float
    size: int
    oldest: bool


class _Slots:
    """The items, a column for each of their properties and for what was last reported; grows by doubling."""

    def __init__(self) -> None:
        n = _FIRST
        self.active = np.zeros(n, np.bool_)
        self.tag = np.zeros(n, np.intp)
        self.queue = np.zeros(n, np.int64)
        self.handle = np.zeros(n, np.uint32)
        self.classes = np.zeros(n, np.uint8)
        self.valued = np.zeros(n, np.bool_)
        self.stamped = np.zeros(n, np.bool_)
        self.band = np.zeros(n)
        self.interval = np.zeros(n)
        self.due = np.zeros(n)
        self.size = np.ones(n, np.int32)
        self.oldest = np.ones(n, np.bool_)
        self.pending = np.zeros(n, np.int32)
        self.fresh = np.zeros(n, np.bool_)
        self.values = np.zeros(n)
        self.statuses = np.zeros(n, np.uint32)
        self.sources = np.zeros(n, np.int64)

    def __len__(self) -> int:
        return len(self.tag)

    def grow(self) -> None:
        for name, column in vars(self).items():
            setattr(self, name, np.concatenate([column, np.zeros_like(column)]))


class Sweep:
    """The items of all subscriptions, and the queue that each reports to.

    An item reports when its tag's status changed since its last report, when the value did, by more than the dead
    band, and when the source timestamp did, each as its trigger says (OPC 10000-4, 7.22.2); NaN equals NaN.
    `slow` counts messages with data changes that were not found here.
    """

    def __init__(self, values: TagValues, watch: Watch) -> None:
        self.slow = 0
        self._values, self._watch = values, watch
        self._classes = classes_of(values.table)
        self._slots = _Slots()
        self._used = 0  # slots that were ever in use
        self._free: list[int] = []
        self._queues: dict[int, Queue] = {}
        self._opened = 0
        self._stamped = self._sampled = False  # there may be items of that kind

    def __len__(self) -> int:
        return self._used - len(self._free)

    @property
    def sampled(self) -> bool:
        """Some items have intervals of their own: they may be due without a new snapshot."""
        return self._sampled

    def open(self, queue: Queue) -> int:
        """A number for this queue."""
        self._opened += 1
        self._queues[self._opened] = queue
        return self._opened

    def close(self, number: int) -> None:
        """The queue's items were removed, and it is gone."""
        self._queues.pop(number, None)

    def add(self, tag: int, queue: int, terms: Terms, *, active: bool) -> int:
        """A new item on this tag; `look` makes its first report. Returns its slot."""
        slots = self._slots
        if not self._free:
            if self._used == len(slots):
                slots.grow()
            self._free.append(self._used)
            self._used += 1
        slot = self._free.pop()
        slots.tag[slot], slots.queue[slot], slots.active[slot] = tag, queue, active
        slots.fresh[slot], slots.pending[slot] = True, 0
        slots.due[slot] = np.inf
        self.modify(slot, terms)
        return slot

    def modify(self, slot: int, terms: Terms) -> None:
        """The item has these terms from now on."""
        slots = self._slots
        slots.handle[slot] = terms.handle
        slots.classes[slot] = with_timestamps(int(self._classes[slots.tag[slot]]), terms.stamps)
        slots.valued[slot], slots.stamped[slot], slots.band[slot] = terms.valued, terms.stamped, terms.band
        slots.size[slot], slots.oldest[slot] = terms.size, terms.oldest
        slots.interval[slot] = terms.interval
        if slots.pending[slot] > terms.size:
            self._queues[int(slots.queue[slot])].overfill()
        slots.due[slot] = min(slots.due[slot], self._watch.now + terms.interval)
        self._stamped |= terms.stamped
        self._sampled |= terms.interval > 0.0

    def set_mode(self, which: NDArray[np.intp], queue: int, *, active: bool) -> None:
        """The items in these slots look at their tags, and report to this queue, from now on; or look no more.

        OPC 10000-4, 5.12.1.3: an item that looks no more forgets what it had to say, and reports anew afterwards.
        """
        slots = self._slots
        for number in np.unique(slots.queue[which]).tolist():
            entries = self._queues[number].pull(which)
            if active and len(entries):
                self._put(queue, entries, bool((slots.pending[which] > slots.size[which]).any()))
        if active:
            slots.fresh[which] |= ~slots.active[which]
        else:
            slots.pending[which] = 0
        slots.active[which], slots.queue[which] = active, queue

    def remove(self, slot: int) -> None:
        """The item is gone."""
        self._slots.active[slot] = False
        self._free.append(slot)
        if not len(self):
            self._stamped = self._sampled = False

    def look(self, which: NDArray[np.intp] | None = None) -> None:
        """Put what is to be reported now into the queues: of all items, or those in these slots."""
        if not len(self):
            return
        slots, values, now = self._slots, self._values, self._watch.now
        some: slice | NDArray[np.intp] = slice(self._used) if which is None else which
        tags, classes, reported = slots.tag[some], slots.classes[some], slots.values[some]
        numbers, statuses, sources = values.values[tags], values.statuses[tags], values.source_timestamps[tags]
        canonical(classes, numbers, statuses)
        moved = (numbers != reported) & ~(np.isnan(numbers) & np.isnan(reported))
        changed = statuses != slots.statuses[some]
        with np.errstate(invalid="ignore", over="ignore"):  # ∞ − ∞ is no number, and reported
            beyond = ~(np.abs(numbers - reported) <= slots.band[some])
        told = changed | slots.fresh[some] | (moved & beyond & slots.valued[some])
        if self._stamped:
            restamped = slots.stamped[some] & (sources // 1000 != slots.sources[some] // 1000)
            told |= restamped
            changed |= restamped
        told &= slots.active[some]
        if self._sampled:
            interval = slots.interval[some]
            ready = (interval == 0.0) | (now + self._watch.interval / 2 >= slots.due[some])
            told &= ready | slots.fresh[some]
            slots.due[some] = np.where(ready & (changed | moved), now + interval, slots.due[some])
        found = np.flatnonzero(told)
        if len(found):
            chosen = found if which is None else which[found]
            self._report(chosen, numbers[found], statuses[found], sources[found])

    def _report(
        self,
        chosen: NDArray[np.intp],
        numbers: NDArray[np.float64],
        statuses: NDArray[np.uint32],
        sources: NDArray[np.int64],
    ) -> None:
        slots = self._slots
        entries = np.empty(len(chosen), ENTRY)
        entries["slot"], entries["handle"], entries["class"] = chosen, slots.handle[chosen], slots.classes[chosen]
        entries["value"], entries["status"], entries["source"] = numbers, statuses, sources
        entries["server"] = self._values.server_timestamp
        slots.values[chosen], slots.statuses[chosen], slots.sources[chosen] = numbers, statuses, sources
        slots.fresh[chosen] = False
        slots.pending[chosen] += 1
        over = slots.pending[chosen] > slots.size[chosen]
        queues = slots.queue[chosen]
        if (queues == queues[0]).all():
            self._put(int(queues[0]), entries, bool(over.any()))
            return
        for number in np.unique(queues):
            own = queues == number
            self._put(int(number), entries[own], bool(over[own].any()))

    def _put(self, number: int, entries: Entries, overfull: bool) -> None:
        self._queues[number].put(entries, overfull, self._slots.size, self._slots.oldest)

    def take(self, number: int, most: int) -> Entries:
        """What a queue has to publish, at most so many."""
        slots, queue = self._slots, self._queues[number]
        entries = queue.take(most, slots.size, slots.oldest)
        slots.pending[entries["slot"]] = 0
        for rest in queue.batches:
            slots.pending[rest["slot"]] = 0
            np.add.at(slots.pending, rest["slot"], 1)
        return entries
