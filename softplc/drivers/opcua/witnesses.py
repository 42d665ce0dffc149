"""Variables that are read while a subscription is silent: has it nothing to report, or does it not report it?

A subscription can die without a word while reads go on; what it showed last then looks like values that stand still.
So the read that proves the server's life also asks for some of the subscribed variables. One whose value differs from
what is shown and is not older by its source timestamp contradicts the subscription; when that goes on for longer than
a report takes, the subscription is dead. Asked is for the server's cached values, which is what it samples: a device
behind it may be ahead of both.
"""

import heapq
import math
from collections.abc import Iterable, Sequence
from typing import Final

from asyncua import ua

from softplc.clock import Clock
from softplc.drivers.opcua.binding import Binding, put, read_value, server_time
from softplc.drivers.opcua.session import Session, batches
from softplc.drivers.opcua.values import decode
from softplc.errors import LinkError
from softplc.tags import Image

MOST: Final = 20
"""Variables in one read: half of them those that were reported last, the others in turn."""
CACHED: Final = float(2**31 - 1)
"""MaxAge with which a server gives what it has (OPC 10000-4, 5.11.2.2)."""


class Witnesses:
    """What a subscription shows in `latest` against what the server says when it is asked."""

    def __init__(self, session: Session, readings: Sequence[Binding], latest: Image, clock: Clock) -> None:
        self._session, self._readings, self._latest, self._clock = session, readings, latest, clock
        self._doubts: dict[int, float] = {}
        self._turn = 0

    def some(self) -> list[int]:
        """Positions among the readings of at most MOST to be asked now."""
        live = self.everybody()
        if len(live) <= MOST:
            return live
        arrivals = self._latest.arrivals
        newest = heapq.nlargest(MOST // 2, live, key=lambda number: arrivals[self._readings[number].uses[0][0]])
        self._turn += MOST // 2
        turn = [live[(self._turn + step) % len(live)] for step in range(MOST // 2)]
        return list(dict.fromkeys((*newest, *turn)))

    def everybody(self) -> list[int]:
        """Positions of all that are subscribed."""
        return [number for number, binding in enumerate(self._readings) if binding.monitored]

    def reported(self, number: int) -> None:
        """The subscription reported this one: it does its work."""
        self._doubts.pop(number, None)

    def reported_all(self, numbers: Iterable[int]) -> None:
        """As `reported`, for many."""
        if self._doubts:
            for number in numbers:
                self._doubts.pop(number, None)

    async def ask(self, numbers: Sequence[int], grace: float) -> float:
        """Read the server's clock and these; `latest` takes over what is newer than what was reported.

        Returns when the answer came, in monotonic seconds. Raises LinkError when there is none, and when the
        subscription kept silent about a change for longer than `grace` seconds.
        """
        nodes = [server_time().node, *(self._readings[number].node for number in numbers)]
        values: list[ua.DataValue] = []
        for batch in batches(nodes, self._session.limits.read):
            values += await self._session.read([read_value(node) for node in batch], CACHED)
        now = self._clock.monotonic()
        for number, data in zip(numbers, values[1:], strict=True):
            binding = self._readings[number]
            if any(self._differs(position, data, index) for position, index in binding.uses):
                put(binding, data, self._latest, now, self._clock.utc_ns())
                if binding.problem:  # it is gone or of another type, which says nothing of the others
                    binding.monitored = False
                elif now - self._doubts.setdefault(number, now) > grace:
                    what = f"{binding.address} changed, and the subscription does not report it"
                    raise LinkError(f"{self._session.url}: {what}")
        return now

    def _differs(self, position: int, data: ua.DataValue, index: int | None) -> bool:
        value, status, stamp = decode(data, index)
        if stamp is not None and stamp <= self._latest.source_timestamps[position]:
            return False
        shown = float(self._latest.values[position])
        same = value == shown or (math.isnan(value) and math.isnan(shown))
        return not same or status >> 30 != int(self._latest.statuses[position]) >> 30
