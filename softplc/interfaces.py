"""Driver, Observer, Publisher: the whole plug-in contract.

Each plug-in is one file or folder in its room: a frozen config model with `type: Literal[...]`, the class
that the model's `build()` returns, and one name in the family's union in `config.py`.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.exchange import Reader
from softplc.tags import Image
from softplc.timing import Scan

Positions = NDArray[np.intp]
"""Which of a driver's writings, by their place in the sequence that it was given; each once."""


class Driver(Protocol):
    """Talks to one device. One object is one connection attempt: opened once, closed once, never reused.

    Its tags (`readings`, `writings`) are given to the constructor by the config model's `build()` as sequences of
    that protocol's tag models; `read` and `write` address them by position.
    """

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with single tags, in words; changes while connected."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """What works, but not as one would wish, in words; known once the driver is open."""
        ...

    @property
    def writes_at_once(self) -> int:
        """How many values one request to the device carries; `write` is given no more at a time."""
        ...

    async def open(self) -> None:
        """Connect, resolve every tag and check its type.

        A tag that is missing or of another type does not fail the others: it reads Bad with the status that
        says why. Raises LinkError when the device cannot be reached or used at all.
        """
        ...

    async def read(self, into: Image) -> None:
        """Fill `into`, one entry for each reading, with the newest samples, their status and arrival.

        A polling driver asks the device; a subscribing driver copies its latest values without waiting, and
        raises LinkError when the device gave no sign of life within its limit. `arrivals` is the monotonic time
        of the reply or notification that brought the sample; `source_timestamps` the device's own, or the time
        of arrival where it has none. Raises LinkError when the connection is of no more use.
        """
        ...

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Write engineering values to the writings at these positions; returns the raw StatusCode of each.

        Raises LinkError when the connection is of no more use.
        """
        ...

    async def close(self) -> None:
        """Let go of the connection, at once and without raising."""
        ...


class Observer(Protocol):
    """Steps all instances of one observer type that share a task."""

    def step(self, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Advance every instance by one scan: latched `inputs` in, published tags in `outputs` out.

        Synchronous; no clock, no log, no I/O; writes only the blocks it was built for.
        """
        ...

    def command(self, index: int, value: float) -> bool:
        """Take a written value for the tag at this index of `outputs`; False when it is none of its writable tags."""
        ...

    def park(self, scan: Scan, outputs: Image) -> None:
        """Mark the estimates of every instance Bad (BadInternalError): the observer raised and runs no more.

        Called in that scan and in all that follow, so that what tells the time of a scan goes on.
        """
        ...


class Publisher(Protocol):
    """Serves the published tags to clients, in the gateway process."""

    async def open(self) -> str:
        """Listen; returns the endpoint as a person would type it. Raises SoftplcError when it cannot."""
        ...

    async def publish(self) -> None:
        """Take over the newest snapshot from the reader given at construction; called at the publisher's interval."""
        ...

    async def close(self) -> None:
        """Stop listening and drop the clients, within a second, without raising."""
        ...


class DriverConfig(Protocol):
    """What every source's config model offers beside its own fields."""

    name: str

    def build(self, readings: Sequence[Any], writings: Sequence[Any], clock: Clock, period: float) -> Driver:
        """A new driver for these tag models and the period in seconds of the task that reads them.

        Imports the heavy library only now.
        """
        ...


class PublisherConfig(Protocol):
    """What every publisher's config model offers beside its own fields."""

    def build(self, reader: Reader) -> Publisher:
        """A new publisher over the exchange's reader."""
        ...
