"""Mode poll: one Read of all variables in every scan, in as few requests as the server takes."""

from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from softplc.clock import Clock
from softplc.drivers.opcua.binding import Binding, put, read_value, server_time
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.read import ReadPlan, plan_reads
from softplc.drivers.opcua.fast.seam import proven
from softplc.drivers.opcua.session import Session, batches
from softplc.tags import Image


@dataclass(frozen=True, slots=True)
class _Batch:
    """One Read request for asyncua's decoder."""

    nodes: tuple[ua.ReadValueId, ...]
    bindings: tuple[Binding, ...]


class Polling:
    """The requests of one connection; `slow` counts what asyncua has to decode."""

    def __init__(self, session: Session, clock: Clock, slow: SlowState) -> None:
        self._session, self._clock, self._slow = session, clock, slow
        self._plans: list[ReadPlan] = []
        self._batches: list[_Batch] = []
        self._unresolved: list[Binding] = []

    def plan(self, bindings: Sequence[Binding]) -> None:
        """Ask for all that are resolved, even with a problem: its status is the server's, and its end is seen."""
        self._unresolved = [binding for binding in bindings if binding.node is None]
        found = [binding for binding in bindings if binding.node is not None] or [server_time()]
        if proven():
            self._plans = plan_reads(self._session, found, self._plans, self._slow)
            return
        self._batches = [
            _Batch(tuple(read_value(binding.node) for binding in some), tuple(some))
            for some in batches(found, self._session.limits.read)
        ]

    async def read(self, into: Image) -> None:
        """Fill `into` from the server. Raises LinkError."""
        for plan in self._plans:
            await plan.read(into)
        for batch in self._batches:
            values = await self._session.read(batch.nodes)
            arrival, now = self._clock.monotonic(), self._clock.utc_ns()
            for binding, data in zip(batch.bindings, values, strict=True):
                put(binding, data, into, arrival, now)
        for binding in self._unresolved:
            into.fail(binding.status, (position for position, _ in binding.uses))
