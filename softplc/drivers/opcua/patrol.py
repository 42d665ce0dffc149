"""Subscribed variables are read in turn, for one of them may fall silent while the others go on reporting.

A monitored item can die alone: its node was deleted, or the server lost it. What it reported last then looks like a
value that stands still. So a few variables at a time are read in the background. What differs from what was reported
has to be reported within the time that a report takes; a variable that is not is read in every scan from then on.
Asked is for the server's cached values, which is what it samples.
"""

from collections.abc import Awaitable, Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.drivers.opcua.binding import Binding
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.read import ReadPlan
from softplc.drivers.opcua.reading import PlainRead, Reads, plan_reads
from softplc.drivers.opcua.session import Session
from softplc.drivers.opcua.witnesses import CACHED
from softplc.tags import Image

EVERY: Final = 0.25
"""Seconds between two requests."""
FEWEST: Final = 50
"""Variables in a request, where there are so many."""
ROUNDS: Final = 20
"""Requests until all were asked, so that many variables cost the server a hundredth of polling them at 50 ms."""
PATIENCE: Final = 0.25
"""Seconds by which a report may be late."""


class Patrol:
    """What a subscription shows in `latest` against what the server says, variable by variable."""

    def __init__(
        self, session: Session, readings: Sequence[Binding], latest: Image, clock: Clock, slow: SlowState
    ) -> None:
        self._session, self._readings, self._latest, self._clock = session, readings, latest, clock
        self._slow = slow
        self._asked = Image(len(latest))
        self._reads: Reads = ()
        self._turn = 0

    def renew(self) -> None:
        """Variables were looked for anew, or subscribed to anew."""
        found = [binding for binding in self._readings if binding.node is not None]
        most = max(FEWEST, -(-len(found) // ROUNDS))
        self._reads = plan_reads(self._session, found, self._reads, self._slow, most, CACHED)

    async def run(self, grace: float, distrust: Callable[[Sequence[Binding]], Awaitable[None]]) -> None:
        """Go round until cancelled; `distrust` takes those that fell silent.

        `grace`: seconds that a report takes. Raises LinkError.
        """
        while True:
            await self._clock.sleep_until(self._clock.monotonic() + EVERY)
            silent = await self._look(grace + PATIENCE)
            if silent:
                await distrust(silent)

    async def _look(self, patience: float) -> list[Binding]:
        """Ask for the next few; those that changed without a report."""
        if not self._reads:
            return []
        part = self._reads[self._turn % len(self._reads)]
        self._turn += 1
        doubtful = await self._ask(part)
        if not doubtful:
            return []
        asked_at = self._clock.monotonic()
        await self._clock.sleep_until(asked_at + patience)
        arrivals = self._latest.arrivals
        unreported = [b for b in doubtful if not any(arrivals[position] > asked_at for position, _ in b.uses)]
        silent: list[Binding] = []
        for part in plan_reads(self._session, unreported, (), self._slow, None, CACHED):
            silent += await self._ask(part)
        return silent

    async def _ask(self, part: ReadPlan | PlainRead) -> list[Binding]:
        """Of its variables, those found other than reported; one that is gone, or of another type, is Bad."""
        watched = [binding for binding in part.bindings if binding.monitored and not binding.problem]
        await part.read(self._asked)
        for binding in watched:
            if binding.problem:
                binding.monitored = False
                self._latest.fail(binding.status, (position for position, _ in binding.uses))
        return self._contradicted([binding for binding in watched if not binding.problem])

    def _contradicted(self, bindings: Sequence[Binding]) -> list[Binding]:
        """Those for which the server gave another value or quality, and none that is older."""
        owners = np.array([number for number, b in enumerate(bindings) for _ in b.uses], np.intp)
        where: NDArray[np.intp] = np.array([position for b in bindings for position, _ in b.uses], np.intp)
        shown, asked = self._latest.values[where], self._asked.values[where]
        differs = (shown != asked) & ~(np.isnan(shown) & np.isnan(asked))
        differs |= self._latest.statuses[where] >> 30 != self._asked.statuses[where] >> 30
        differs &= self._asked.source_timestamps[where] >= self._latest.source_timestamps[where]
        return [bindings[number] for number in np.unique(owners[differs])]
