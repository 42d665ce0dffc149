"""A recording (CSV) as a source: samples come when the clock reaches their time."""

from collections.abc import Sequence
from typing import Literal

from softplc.clock import Clock
from softplc.interfaces import Driver
from softplc.model import Model, Name


class ReplaySource(Model):
    """A recording: CSV with a header, a time column and one column for each tag."""

    type: Literal["replay"]
    name: Name
    file: str
    """Path of the CSV file, relative to the working directory."""
    time_column: str = "t"
    """Column with the time of each row, in seconds from any start, ascending."""

    def build(
        self, readings: Sequence["ReplayTag"], writings: Sequence["ReplayTag"], clock: Clock, period: float
    ) -> Driver:
        """A driver that starts the recording when it is opened."""
        raise NotImplementedError


class ReplayTag(Model):
    """One column of a recording."""

    source: Name
    column: str
    """Name of the CSV column."""

    def __str__(self) -> str:
        return self.column
