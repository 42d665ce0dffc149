"""The seam between the scan process and the gateway: snapshots one way, commands the other.

Snapshots cross in shared memory as a structure of arrays, one sequence-locked section for each task: the writer
makes the section's sequence odd, copies, makes it even again; a reader copies and keeps the copy only if the
sequence was even and did not change meanwhile. Newest wins; nothing is ever torn and nobody ever waits.
Commands (tag index, value) cross in a bounded ring with one writer and one reader; a full ring refuses.

The scan process trusts nothing that it finds here: what it counts itself (the sequences, where it is in the ring) it
keeps, and a ring that makes no sense is refused as a whole. The supervisor looks on (Pulse).
"""

import threading
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.sample import StatusCode
from softplc.snapshot import Sheets, Snapshot
from softplc.tags import Image, TagTable
from softplc.timing import Scan

COMMANDS: Final = 256  # slots of the ring; one is kept free to tell full from empty
DEAD_AFTER_PERIODS: Final = 3.0  # a task that does not scan for so long is dead for the gateway
DEAD_AFTER_AT_LEAST: Final = 0.25  # seconds; a shared machine may pause a process for some tens of ms
_MAGIC: Final = 0x534F4654504C4301
_READ_TRIES: Final = 64


def size(table: TagTable) -> int:
    """Bytes of shared memory that the exchange of this table takes."""
    return _Layout(table).nbytes


class _Layout:
    """Where each array lies in the buffer; all offsets are multiples of 8."""

    def __init__(self, table: TagTable) -> None:
        n, m = len(table), len(table.sections)
        self.fields: dict[str, tuple[int, Any, tuple[int, ...]]] = {}
        self.nbytes = 0
        self._add("header", np.int64, (8,))
        self._add("integers", np.int64, (m, 4))  # sequence, number, timestamp, overruns
        self._add("seconds", np.float64, (m, 3))  # start, dt, period
        self._add("command_index", np.int64, (COMMANDS,))
        self._add("command_value", np.float64, (COMMANDS,))
        self._add("values", np.float64, (n,))
        self._add("source_timestamps", np.int64, (n,))
        self._add("statuses", np.uint32, (n,))

    def _add(self, name: str, dtype: Any, shape: tuple[int, ...]) -> None:
        self.fields[name] = (self.nbytes, dtype, shape)
        nbytes = int(np.prod(shape)) * np.dtype(dtype).itemsize
        self.nbytes += (nbytes + 7) // 8 * 8


class _Memory:
    """The shared arrays of one exchange."""

    def __init__(self, buffer: Any, table: TagTable) -> None:
        def view(name: str) -> NDArray[Any]:
            offset, dtype, shape = layout.fields[name]
            return np.frombuffer(buffer, dtype, int(np.prod(shape)), offset).reshape(shape)

        layout = _Layout(table)
        self.header = view("header")  # magic, tags, command head (gateway), command tail (scan), beats (gateway)
        self.integers = view("integers")
        self.seconds = view("seconds")
        self.command_index = view("command_index")
        self.command_value = view("command_value")
        self.values = view("values")
        self.source_timestamps = view("source_timestamps")
        self.statuses = view("statuses")
        self._fence = threading.Lock()

    def fence(self) -> None:
        """Order memory accesses before and after; taking a lock is a full barrier on every CPU that we run on."""
        with self._fence:
            pass


_COMMAND_HEAD: Final = 2
_COMMAND_TAIL: Final = 3
_BEATS: Final = 4
_LARGEST: Final = 2**62  # of a counter that is taken over from shared memory


class Writer:
    """The scan process' end: publishes sections, takes commands.

    `refused` counts how often the ring of commands was found in a state that no gateway leaves it in.
    """

    def __init__(self, buffer: Any, table: TagTable) -> None:
        self.refused = 0
        self._memory = _Memory(buffer, table)
        self._sections = [(start, stop) for _, start, stop in table.sections]
        self._memory.header[0] = _MAGIC
        self._memory.header[1] = len(table)
        self._sequences = [int(sequence) % _LARGEST for sequence in self._memory.integers[:, 0]]
        self._tail = int(self._memory.header[_COMMAND_TAIL])
        self._senseless: int | None = None
        if not (
            0 <= self._waiting() < COMMANDS and 0 <= self._tail < _LARGEST
        ):  # of a predecessor's commands nothing is left that makes sense
            self._tail = int(self._memory.header[_COMMAND_HEAD]) % _LARGEST
            self._memory.header[_COMMAND_TAIL] = self._tail

    def publish(self, section: int, scan: Scan, image: Image) -> None:
        """Copy one task's run of the image into its section; never waits."""
        memory, (start, stop) = self._memory, self._sections[section]
        record = memory.integers[section]
        sequence = self._sequences[section] | 1  # a predecessor may have died half-way: odd stays odd
        record[0] = sequence
        memory.fence()
        memory.values[start:stop] = image.values[start:stop]
        memory.statuses[start:stop] = image.statuses[start:stop]
        memory.source_timestamps[start:stop] = image.source_timestamps[start:stop]
        record[1:] = scan.number, scan.timestamp, scan.overruns
        memory.seconds[section] = scan.start, scan.dt, scan.period
        memory.fence()
        record[0] = self._sequences[section] = sequence + 1

    def commands(self) -> list[tuple[int, float]]:
        """Commands that the gateway put since the last call, oldest first, as (tag index, value).

        They are fewer than COMMANDS, and as they were found: whoever takes them judges them. A head that is no place
        of the ring is refused, once for each; the gateway puts it right before its next command.
        """
        memory, waiting = self._memory, self._waiting()
        if memory.header[_COMMAND_TAIL] != self._tail:  # where we are is ours to say
            memory.header[_COMMAND_TAIL] = self._tail
        if waiting == 0:
            self._senseless = None
            return []
        if not 0 < waiting < COMMANDS:
            if self._senseless != self._tail + waiting:
                self._senseless = self._tail + waiting
                self.refused += 1
            return []
        self._senseless = None
        memory.fence()
        slots = [(self._tail + k) % COMMANDS for k in range(waiting)]
        taken = [(int(memory.command_index[slot]), float(memory.command_value[slot])) for slot in slots]
        memory.fence()
        self._tail += waiting
        memory.header[_COMMAND_TAIL] = self._tail
        return taken

    def _waiting(self) -> int:
        return int(self._memory.header[_COMMAND_HEAD]) - self._tail


class Reader:
    """The gateway's end: newest snapshot at any time, commands in."""

    def __init__(self, buffer: Any, table: TagTable, clock: Clock) -> None:
        self.table = table
        self._memory = _Memory(buffer, table)
        self.clock = clock
        self._sequences = [0] * len(table.sections)
        self._alive = [False] * len(table.sections)
        self._scans: list[Scan | None] = [None] * len(table.sections)
        self._sheets = Sheets(table)
        self._snapshot: Snapshot | None = None

    def snapshot(self) -> Snapshot:
        """The newest consistent state of every section; the same object as before when nothing changed.

        What changed is copied once, out of the shared memory into arrays that nobody holds any more.
        """
        changed = self._snapshot is None
        now = self.clock.monotonic()
        for section, (_, start, stop) in enumerate(self.table.sections):
            taken = self._take(section, start, stop)
            changed |= self._judge(section, start, stop, now, taken) or taken
        if changed or self._snapshot is None:
            version = self._snapshot.version + 1 if self._snapshot else 1
            arrays = self._sheets.newest().frozen()
            self._snapshot = Snapshot(version, *arrays, tuple(self._scans), tuple(self._alive))
        return self._snapshot

    def command(self, index: int, value: float) -> bool:
        """Hand a validated value for a writable tag to the scan process; False when the ring is full."""
        header = self._memory.header
        head, tail = int(header[_COMMAND_HEAD]), int(header[_COMMAND_TAIL])
        if not 0 <= head - tail < COMMANDS:  # another gateway's ruins
            head = tail
        if head - tail >= COMMANDS - 1 or not 0 <= tail < _LARGEST:
            return False
        slot = head % COMMANDS
        self._memory.command_index[slot] = index
        self._memory.command_value[slot] = value
        self._memory.fence()
        header[_COMMAND_HEAD] = head + 1
        return True

    def beat(self) -> None:
        """Show the supervisor that the gateway's event loop turns."""
        header = self._memory.header
        header[_BEATS] = (int(header[_BEATS]) + 1) % _LARGEST

    def _take(self, section: int, start: int, stop: int) -> bool:
        """Copy the section if it moved on; False when it did not or when no consistent copy was to be had."""
        memory, record = self._memory, self._memory.integers[section]
        for _ in range(_READ_TRIES):
            before = int(record[0])
            if before == self._sequences[section]:
                return False
            if before % 2:
                continue
            sheet = self._sheets.fill(section)
            memory.fence()
            sheet.values[start:stop] = memory.values[start:stop]
            sheet.statuses[start:stop] = memory.statuses[start:stop]
            sheet.source_timestamps[start:stop] = memory.source_timestamps[start:stop]
            _, number, timestamp, overruns = (int(field) for field in record)
            begun, dt, period = (float(field) for field in memory.seconds[section])
            memory.fence()
            if int(record[0]) == before:
                self._sheets.filled(section)
                self._scans[section] = Scan(number, begun, timestamp, dt, period, overruns)
                self._sequences[section] = before
                return True
        return False

    def _judge(self, section: int, start: int, stop: int, now: float, taken: bool) -> bool:
        """A task that stopped scanning has no values any more: NaN and BadNoCommunication."""
        scan = self._scans[section]
        if scan is None:
            return False
        limit = max(DEAD_AFTER_PERIODS * scan.period, DEAD_AFTER_AT_LEAST)
        alive = now - scan.start <= limit
        changed = alive != self._alive[section]
        self._alive[section] = alive
        if not alive and (changed or taken):  # what a dead task left behind is old the moment it is taken
            sheet = self._sheets.change(section)
            sheet.values[start:stop] = np.nan
            sheet.statuses[start:stop] = StatusCode.BAD_NO_COMMUNICATION
            self._sheets.filled(section)
        return changed


class Pulse:
    """What the supervisor sees of both ends: counters that move while a process does what it is there for."""

    def __init__(self, buffer: Any, table: TagTable) -> None:
        self._memory = _Memory(buffer, table)

    def scan(self, section: int) -> int:
        """Moves with every scan of the section's task."""
        return int(self._memory.integers[section, 0])

    def gateway(self) -> int:
        """Moves with every beat of the gateway."""
        return int(self._memory.header[_BEATS])
