"""Variables that are read while a subscription is silent: has it nothing to report, or does it not report it?

A subscription can die without a word while reads go on; what it showed last then looks like values that stand still.
So the read that proves the server's life also asks for some of the subscribed variables. One that differs from what
was reported, and goes on differing for longer than a report takes, is a change that the subscription did not report.
Asked is for the server's cached values, which is what it samples: a device behind it may be ahead of both.
"""

import heapq
import math
from collections.abc import Sequence
from typing import Final

from asyncua import ua

from softplc.drivers.opcua.binding import Binding
from softplc.drivers.opcua.values import decode
from softplc.tags import Image

MOST: Final = 20
"""Variables in one read: half of them those that were reported last, the others in turn."""
CACHED: Final = float(2**31 - 1)
"""MaxAge with which a server gives what it has (OPC 10000-4, 5.11.2.2)."""


class Witnesses:
    """What a subscription shows in `latest` against what the server says when it is asked."""

    def __init__(self, readings: Sequence[Binding], latest: Image) -> None:
        self._readings, self._latest = readings, latest
        self._doubts: dict[int, float] = {}
        self._turn = 0

    def call(self) -> list[int]:
        """Positions among the readings of those to be asked now."""
        live = [number for number, binding in enumerate(self._readings) if binding.monitored]
        if len(live) <= MOST:
            return live
        arrivals = self._latest.arrivals
        newest = heapq.nlargest(MOST // 2, live, key=lambda number: arrivals[self._readings[number].uses[0][0]])
        self._turn += MOST // 2
        turn = [live[(self._turn + step) % len(live)] for step in range(MOST // 2)]
        return list(dict.fromkeys((*newest, *turn)))

    def reported(self, number: int) -> None:
        """The subscription reported this one: it does its work."""
        self._doubts.pop(number, None)

    def judge(self, numbers: Sequence[int], values: Sequence[ua.DataValue], now: float, grace: float) -> str:
        """What the subscription kept silent about for longer than `grace` seconds, in words; empty when nothing."""
        for number, data in zip(numbers, values, strict=True):
            binding = self._readings[number]
            if all(self._agrees(position, data, index) for position, index in binding.uses):
                self._doubts.pop(number, None)
            elif now - self._doubts.setdefault(number, now) > grace:
                return f"{binding.address} changed, and the subscription does not report it"
        return ""

    def _agrees(self, position: int, data: ua.DataValue, index: int | None) -> bool:
        value, status, _ = decode(data, index)
        shown = float(self._latest.values[position])
        same = value == shown or (math.isnan(value) and math.isnan(shown))
        return same and status >> 30 == int(self._latest.statuses[position]) >> 30
