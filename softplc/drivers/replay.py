"""A recording (CSV) as a source: samples come when the clock reaches their time."""

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from softplc.clock import Clock
from softplc.errors import LinkError
from softplc.interfaces import Driver, Positions
from softplc.model import Model, Name
from softplc.sample import StatusCode
from softplc.tags import Image


class ReplaySource(Model):
    """A recording: CSV with a header, a time column and one column for each tag."""

    type: Literal["replay"]
    name: Name
    """How tags refer to it."""
    file: Annotated[str, Field(min_length=1)]
    """Path of the CSV file, relative to the working directory."""
    time_column: Annotated[str, Field(min_length=1)] = "t"
    """Column with the time of each row, in seconds from any start, ascending."""

    def build(
        self, readings: Sequence["ReplayTag"], writings: Sequence["ReplayTag"], clock: Clock, period: float
    ) -> Driver:
        """A driver that starts the recording when it is opened."""
        del writings, period  # nothing is written into a recording; its rows have their own times
        return ReplayDriver(self, readings, clock)


class ReplayTag(Model):
    """One column of a recording."""

    source: Name
    """Name of a recording."""
    column: Annotated[str, Field(min_length=1)]
    """Name of the CSV column."""

    def __str__(self) -> str:
        return self.column


class ReplayDriver:
    """Plays a recording from the moment it is opened; after the last row its samples are BadNoCommunication.

    An empty cell is a Bad sample (BadSensorFailure). The source timestamps are the recording's own times, set
    on the wall clock of the moment it was opened.
    """

    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    writes_at_once = 1

    def __init__(self, source: ReplaySource, readings: Sequence[ReplayTag], clock: Clock) -> None:
        self._source, self._readings, self._clock = source, readings, clock
        self._times: NDArray[np.float64] = np.empty(0)
        self._values: NDArray[np.float64] = np.empty((0, 0))
        self._opened = 0.0
        self._start_utc = 0

    async def open(self) -> None:
        """Read the whole recording. Raises LinkError with file, row and column when it is not as declared."""
        columns = [self._source.time_column, *(tag.column for tag in self._readings)]
        table = read_columns(Path(self._source.file), columns)
        self._times = table[:, 0] - table[0, 0]
        if not (np.all(np.isfinite(self._times)) and np.all(np.diff(self._times) >= 0)):
            raise LinkError(f"{self._source.file}: column {self._source.time_column} must ascend and have no gaps")
        self._values = table[:, 1:]
        self._opened = self._clock.monotonic()
        self._start_utc = self._clock.utc_ns()

    async def read(self, into: Image) -> None:
        """The newest row whose time has come."""
        elapsed = self._clock.monotonic() - self._opened
        row = int(np.searchsorted(self._times, elapsed + 1e-9, side="right")) - 1
        if elapsed > self._times[-1] + self.tail:
            into.fail(StatusCode.BAD_NO_COMMUNICATION)
            return
        into.values[:] = self._values[row]
        into.statuses[:] = np.where(np.isnan(into.values), np.uint32(StatusCode.BAD_SENSOR_FAILURE), np.uint32(0))
        into.source_timestamps[:] = self._start_utc + round(self._times[row] * 1e9)
        into.arrivals[:] = self._opened + self._times[row]

    @property
    def tail(self) -> float:
        """Seconds that the last row counts as current: the mean distance of rows."""
        rows = len(self._times)
        return float(self._times[-1] / (rows - 1)) if rows > 1 else math.inf

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Nothing can be written into a recording."""
        return np.full(len(positions), StatusCode.BAD_NOT_WRITABLE, np.uint32)

    async def close(self) -> None:
        """Nothing to let go."""


def read_columns(path: Path, columns: Sequence[str]) -> NDArray[np.float64]:
    """The named columns of a CSV file as float64[rows, columns]; empty cells are NaN.

    Lines that begin with # before the header are comments. Raises LinkError with the place of what is wrong.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:  # spreadsheets put a mark at the beginning
            return _parse(path, file, columns)
    except OSError as error:
        raise LinkError(f"{path}: cannot read the recording: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LinkError(f"{path}: the recording is not UTF-8 text: {error.reason}") from error


def recording_seconds(source: ReplaySource) -> float:
    """Length of a recording in seconds. Raises LinkError."""
    times = read_columns(Path(source.file), [source.time_column])[:, 0]
    return float(times[-1] - times[0])


def rows_seen(source: ReplaySource, period: float) -> tuple[int, int]:
    """How many rows of a recording a task of this period in seconds comes to see, and how many there are."""
    times = read_columns(Path(source.file), [source.time_column])[:, 0]
    times = times - times[0]
    scans = np.arange(round(times[-1] / period) + 1) * period
    seen = np.unique(np.searchsorted(times, scans + 1e-9, side="right"))
    return len(seen), len(times)


def _parse(path: Path, lines: Iterable[str], columns: Sequence[str]) -> NDArray[np.float64]:
    rows = csv.reader(line for line in lines if not line.startswith("#"))
    header = next(rows, [])
    missing = [column for column in columns if column not in header]
    if missing:
        raise LinkError(f"{path}: no column {missing[0]!r}; the header has {', '.join(header) or 'nothing'}")
    positions = [header.index(column) for column in columns]
    table = []
    for number, row in enumerate(rows, start=2):
        try:
            table.append([float(row[position] or "nan") for position in positions])
        except (ValueError, IndexError):
            expected = ", ".join(columns)
            raise LinkError(f"{path}: line {number}: expected numbers under {expected}, found {row}") from None
    if not table:
        raise LinkError(f"{path}: the recording has a header but no rows")
    return np.array(table, dtype=np.float64)
