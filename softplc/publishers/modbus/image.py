"""A snapshot as registers: every value scattered to its place at once, by numpy."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.publishers.modbus.rows import BadValues, ByteOrder, Origin, RegisterMap, RegisterType, Row
from softplc.sample import AxisState, Quality, Reason, StatusCode
from softplc.snapshot import Snapshot

_UNKNOWN_AGE: Final = 65535.0

# (byte order of the whole value, whether its words are then written last to first); A is the most significant byte
_ORDERS: Final[dict[ByteOrder, tuple[str, bool]]] = {
    "ABCD": (">", False),
    "CDAB": (">", True),
    "BADC": ("<", True),
    "DCBA": ("<", False),
}
_NUMPY: Final = {
    RegisterType.UINT16: "u2",
    RegisterType.UINT32: "u4",
    RegisterType.INT64: "i8",
    RegisterType.FLOAT32: "f4",
}
_LIMITS: Final = {  # what a float64 may be to fit; integers saturate
    RegisterType.UINT16: (0.0, 65535.0),
    RegisterType.UINT32: (0.0, 2.0**32 - 1),
    RegisterType.INT64: (-(2.0**63), 2.0**63 - 1024),
}


class RegisterImage:
    """All registers of a map as bytes, encoded once for each new snapshot.

    The bytes of one `encode` are one scan of each task and never change afterwards: whoever slices them cannot see
    half a value. Values of several registers follow the map's byte order; a single register is big-endian, as the
    protocol has it. While a tag is Bad its float reads as its last usable value (`bad_values` hold) or as NaN; an
    integer keeps its last usable value, but for Quality and Connected, which read 0, State, which reads 4 (no
    values; 0 before the first scan), and Reason, which says why.
    A float that was never usable reads NaN, an integer 0.
    """

    def __init__(self, register_map: RegisterMap, tags: int, bad_values: BadValues) -> None:
        rows = register_map.rows
        self._vector = _Vector(rows, tags, hold=bad_values == "hold")
        self._registers: NDArray[np.uint16] = np.zeros(register_map.size, np.uint16)
        self._groups = [_Group.of(rows, kind, self._vector, register_map.byte_order) for kind in RegisterType]
        self._version = 0
        self._bytes = b""

    def encode(self, snapshot: Snapshot) -> bytes:
        """The registers of this snapshot; the same object as before when the snapshot is the same."""
        if snapshot.version != self._version:
            with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is infinite; NaN stays NaN
                vector = self._vector.fill(snapshot)
                for group in self._groups:
                    group.scatter(vector, self._registers)
            self._version, self._bytes = snapshot.version, self._registers.tobytes()
        return self._bytes


class _Vector:
    """All that a register can show, as one float64 array.

    [floats by tag] [integers by tag] [StatusCodes] [milliseconds] [alive by section, and all] [constants]
    """

    def __init__(self, rows: Sequence[Row], tags: int, *, hold: bool) -> None:
        def indices(*origins: Origin) -> NDArray[np.intp]:
            return np.array([row.index for row in rows if row.origin in origins], np.intp)

        def tags_named(leaf: str) -> NDArray[np.intp]:
            chosen = [row.index for row in rows if row.origin is Origin.TAG and row.name.endswith(f".{leaf}")]
            return np.array(chosen, np.intp)

        self._hold = hold
        self._held: NDArray[np.float64] = np.full(tags, np.nan)
        self._status_tags = indices(Origin.STATUS)
        self._age_tags = indices(Origin.MILLISECONDS)
        self._constants = np.array([row.value for row in rows if row.origin is Origin.CONSTANT])
        self._quality = np.concatenate([tags_named("Quality"), tags_named("Connected")])
        self._reason, self._state = tags_named("Reason"), tags_named("State")
        self._sources = self._find(rows, tags)

    def _find(self, rows: Sequence[Row], tags: int) -> dict[int, int]:
        """Where in the vector each row finds its value, by address."""
        sections = max((row.index + 1 for row in rows if row.origin is Origin.ALIVE), default=0)
        starts = np.cumsum([0, tags, tags, len(self._status_tags), len(self._age_tags), sections, 1])
        floats, integers, statuses, ages, alive, all_alive, constants = (int(start) for start in starts)
        self._sections = sections
        counters = {Origin.STATUS: statuses, Origin.MILLISECONDS: ages, Origin.CONSTANT: constants}
        found = {}
        for row in rows:
            if row.origin is Origin.TAG:
                base = floats if row.type is RegisterType.FLOAT32 else integers
                found[row.address] = base + row.index
            elif row.origin is Origin.ALIVE:
                found[row.address] = alive + row.index
            elif row.origin is Origin.ALL_ALIVE:
                found[row.address] = all_alive
            else:
                found[row.address] = counters[row.origin]
                counters[row.origin] += 1
        return found

    def source(self, row: Row) -> int:
        """Index of the row's value in the filled vector."""
        return self._sources[row.address]

    def fill(self, snapshot: Snapshot) -> NDArray[np.float64]:
        """The values of this snapshot; NaN where there is none to show."""
        usable = snapshot.statuses < StatusCode.BAD
        np.copyto(self._held, snapshot.values, where=usable)
        integers = self._held.copy()
        integers[self._quality[~usable[self._quality]]] = Quality.BAD
        states = self._state[~usable[self._state]]
        waiting = snapshot.statuses[states] == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
        integers[states] = np.where(waiting, AxisState.INIT, AxisState.FAIL)
        silent = self._reason[~usable[self._reason]]
        waiting = snapshot.statuses[silent] == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
        integers[silent] = np.where(waiting, Reason.WAITING, Reason.NO_COMMUNICATION)
        return np.concatenate(
            [
                self._held if self._hold else snapshot.values,
                integers,
                snapshot.statuses[self._status_tags],
                np.nan_to_num(np.rint(snapshot.values[self._age_tags] * 1e3), nan=_UNKNOWN_AGE),
                snapshot.alive[: self._sections],
                [all(snapshot.alive)],
                self._constants,
            ]
        )


@dataclass(frozen=True, slots=True)
class _Group:
    """All rows of one register type: n entries of the vector in, their words out.

    `sources` [n] index the vector, `words` [n · registers] the register of each word as it lies in memory.
    """

    kind: RegisterType
    dtype: str
    sources: NDArray[np.intp]
    highest: NDArray[np.float64]
    words: NDArray[np.intp]

    @classmethod
    def of(cls, rows: Sequence[Row], kind: RegisterType, vector: _Vector, byte_order: ByteOrder) -> "_Group":
        rows = [row for row in rows if row.type is kind]
        endian, swap = _ORDERS[byte_order] if kind.registers > 1 else _ORDERS["ABCD"]
        offsets = np.arange(kind.registers)
        addresses = np.array([row.address for row in rows], np.intp)
        words = addresses[:, None] + (offsets[::-1] if swap else offsets)
        return cls(
            kind,
            endian + _NUMPY[kind],
            np.array([vector.source(row) for row in rows], np.intp),
            np.array([1.0 if row.boolean else _LIMITS[kind][1] for row in rows]) if kind in _LIMITS else np.empty(0),
            words.ravel(),
        )

    def scatter(self, vector: NDArray[np.float64], registers: NDArray[np.uint16]) -> None:
        """Write every value of the group into its registers."""
        values = vector[self.sources]
        if self.kind in _LIMITS:
            values = np.clip(np.nan_to_num(values), _LIMITS[self.kind][0], self.highest)
        registers[self.words] = values.astype(self.dtype).view(np.uint16)
