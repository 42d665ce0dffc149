"""Tags, and the arrays that hold their samples: one index per tag, one array per field."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from softplc.sample import Sample, StatusCode

NO_TIMESTAMP = 0  # in source_timestamps: there is none


class Role(StrEnum):
    """What a tag is to the observer (IEC 61131-3: VAR_INPUT, VAR_OUTPUT, VAR, parameter)."""

    INPUT = "input"
    OUTPUT = "output"
    DIAGNOSTIC = "diagnostic"
    TUNING = "tuning"


class DataType(StrEnum):
    """How a tag appears on the servers; inside, every value is a float64."""

    DOUBLE = "Double"
    BOOLEAN = "Boolean"
    UINT16 = "UInt16"
    UINT32 = "UInt32"
    INT64 = "Int64"


@dataclass(frozen=True, slots=True)
class Tag:
    """A named variable. `name` is its path and its OPC-UA string node id, as in `AxisX.Position`.

    `range` is what it usually lies in, for an HMI's scales; `limits` are those of a written value, both allowed.
    """

    name: str
    unit: str = ""
    description: str = ""
    role: Role = Role.DIAGNOSTIC
    data_type: DataType = DataType.DOUBLE
    range: tuple[float, float] | None = None
    writable: bool = False
    limits: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Block:
    """A contiguous run of tags that belong together on the servers: one axis, one task, one source.

    `kind` says which table of tags it follows ("axis", "task", "source"); `start` is the index of its first tag.
    """

    name: str
    kind: str
    start: int
    tags: tuple[Tag, ...]

    @property
    def stop(self) -> int:
        """Index after the last tag of the block."""
        return self.start + len(self.tags)

    def index(self, leaf: str) -> int:
        """Index of the block's tag with this last name part, as in `block.index("Position")`."""
        for offset, tag in enumerate(self.tags):
            if tag.name.rpartition(".")[2] == leaf:
                return self.start + offset
        raise KeyError(f"{self.name} has no tag {leaf}")


class TagTable:
    """All tags of the scan process, in order: name → index, blocks, and one section for each task.

    A section is the run of tags that one task writes in one scan; it crosses to the gateway as one piece.
    """

    def __init__(self) -> None:
        self.tags: list[Tag] = []
        self.blocks: list[Block] = []
        self.sections: list[tuple[str, int, int]] = []
        self._index: dict[str, int] = {}

    def add_block(self, name: str, kind: str, tags: Sequence[Tag]) -> Block:
        """Append the tags of one block; names must be new. Raises ValueError on a duplicate."""
        block = Block(name, kind, len(self.tags), tuple(tags))
        for tag in tags:
            if tag.name in self._index:
                raise ValueError(f"tag {tag.name} exists twice")
            self._index[tag.name] = len(self.tags)
            self.tags.append(tag)
        self.blocks.append(block)
        return block

    def close_section(self, task: str) -> tuple[int, int]:
        """Everything added since the last section belongs to this task; returns its (start, stop)."""
        start = self.sections[-1][2] if self.sections else 0
        self.sections.append((task, start, len(self.tags)))
        return start, len(self.tags)

    def __len__(self) -> int:
        return len(self.tags)

    def __iter__(self) -> Iterator[Tag]:
        return iter(self.tags)

    def __contains__(self, name: str) -> bool:
        return name in self._index

    def index(self, name: str) -> int:
        """Index of a tag by its full name. Raises KeyError."""
        return self._index[name]

    def section_of(self, index: int) -> int:
        """Number of the section that holds a tag index."""
        for number, (_, start, stop) in enumerate(self.sections):
            if start <= index < stop:
                return number
        raise IndexError(f"tag index {index} is in no section")


class Image:
    """The process image: samples as a structure of arrays.

    `values` float64[n], `statuses` uint32[n] raw StatusCodes, `source_timestamps` int64[n] ns UTC (0: none),
    `arrivals` float64[n] monotonic seconds at which each sample reached us (NaN: never), `causes` uint8[n] the
    Reason for which we gave a sample another status than its source did (0: we did not). A new image waits for its
    first data: NaN, BadWaitingForInitialData.
    """

    __slots__ = ("arrivals", "causes", "source_timestamps", "statuses", "values")

    def __init__(self, n: int) -> None:
        self.values: NDArray[np.float64] = np.full(n, np.nan)
        self.statuses: NDArray[np.uint32] = np.full(n, StatusCode.BAD_WAITING_FOR_INITIAL_DATA, np.uint32)
        self.source_timestamps: NDArray[np.int64] = np.full(n, NO_TIMESTAMP, np.int64)
        self.arrivals: NDArray[np.float64] = np.full(n, np.nan)
        self.causes: NDArray[np.uint8] = np.zeros(n, np.uint8)

    def __len__(self) -> int:
        return len(self.values)

    def put(self, index: int, sample: Sample, arrival: float = np.nan) -> None:
        """Store one sample."""
        self.values[index] = sample.value
        self.statuses[index] = sample.status
        self.source_timestamps[index] = sample.source_timestamp or NO_TIMESTAMP
        self.arrivals[index] = arrival

    def take_over(self, other: "Image", start: int = 0) -> None:
        """Copy every sample of another image to index `start` and after."""
        stop = start + len(other)
        self.values[start:stop] = other.values
        self.statuses[start:stop] = other.statuses
        self.source_timestamps[start:stop] = other.source_timestamps
        self.arrivals[start:stop] = other.arrivals
        self.causes[start:stop] = other.causes

    def sample(self, index: int) -> Sample:
        """One sample out of the arrays."""
        stamp = int(self.source_timestamps[index])
        return Sample(float(self.values[index]), int(self.statuses[index]), None if stamp == NO_TIMESTAMP else stamp)

    def fail(self, status: int, indices: Iterable[int] | slice = slice(None)) -> None:
        """Mark samples Bad; values become NaN, source timestamps stay, so that their age can be told."""
        where = indices if isinstance(indices, slice) else list(indices)
        self.values[where] = np.nan
        self.statuses[where] = status
