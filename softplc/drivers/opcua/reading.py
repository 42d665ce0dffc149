"""Reads of always the same variables, in as few requests as the server's limits allow."""

from collections.abc import Sequence

from softplc.drivers.opcua.binding import Binding, put, read_value
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.read import ReadPlan
from softplc.drivers.opcua.fast.seam import proven
from softplc.drivers.opcua.session import Session, batches
from softplc.tags import Image


class PlainRead:
    """One Read request, coded by asyncua; as ReadPlan."""

    def __init__(self, session: Session, bindings: Sequence[Binding], slow: SlowState, max_age: float = 0.0) -> None:
        self.bindings = tuple(bindings)
        self._session, self._slow, self._max_age = session, slow, max_age
        self._nodes = [read_value(binding.node) for binding in bindings]

    async def read(self, into: Image) -> None:
        """Fill `into`. Raises LinkError."""
        values = await self._session.read(self._nodes, self._max_age)
        self._slow.messages += 1
        arrival, now = self._session.arrival()
        for binding, data in zip(self.bindings, values, strict=True):
            put(binding, data, into, arrival, now)


Reads = Sequence[ReadPlan] | Sequence[PlainRead]


def plan_reads(
    session: Session,
    bindings: Sequence[Binding],
    before: Reads,
    slow: SlowState,
    most: int | None = None,
    max_age: float = 0.0,
) -> Reads:
    """The Reads for all these bindings, of which those that still serve are taken from the plans `before`.

    At most `most` in a request, or the server's own limit. `max_age` in ms.
    """
    at_once = session.limits.read if most is None else min(most, session.limits.read)
    if not proven():
        return [PlainRead(session, some, slow, max_age) for some in batches(bindings, at_once)]
    plans: list[ReadPlan] = []
    for number, some in enumerate(batches(bindings, at_once)):
        plan = before[number] if number < len(before) else None
        if not isinstance(plan, ReadPlan) or not plan.serves(some):
            plan = ReadPlan(session, some, slow, max_age)
        plan.renew()
        plans.append(plan)
    return plans
