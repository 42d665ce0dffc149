"""How much of its period each task will take: a prediction from the configuration and the measured costs; no I/O."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from softplc.app.costs import MACHINE, MEASURED, Cost, Costs
from softplc.app.layout import Layout, SourceLayout, TaskLayout

if TYPE_CHECKING:
    from softplc.drivers.modbus.plan import Request

MUCH: Final = 0.5  # of the period; beyond it the next thing that takes the processor makes a scan late
_READS: Final = 5000  # tags of one OPC-UA Read where the server takes no fewer
_NAMED: Final = 3  # sources that are shown one by one
_MS: Final = 1e-3  # of a µs
_BITS: Final = 11.0  # of a byte on a serial line
_FRAMING: Final = 8 + 5 + 7  # bytes of a request, of an answer beside its data, and of the silences around them


@dataclass(frozen=True, slots=True)
class Share:
    """A part of a scan: `own` is softplc's time, `device` what it waits for the answers to its requests, ms."""

    what: str
    own: float
    device: float = 0.0
    requests: int = 0

    def __str__(self) -> str:
        if not self.requests:
            return f"{self.what} {_ms(self.own)}"
        asked = "1 request" if self.requests == 1 else f"{self.requests} requests"
        return f"{self.what} {asked}, {_ms(self.own)} + {_ms(self.device)} until the answer"


@dataclass(frozen=True, slots=True)
class Budget:
    """One task's scan: its period and its parts, ms. Sources answer side by side, so the slowest is waited for."""

    task: str
    period: float
    shares: tuple[Share, ...]

    @property
    def total(self) -> float:
        """The whole scan, ms."""
        return sum(share.own for share in self.shares) + max(share.device for share in self.shares)

    @property
    def own(self) -> float:
        """softplc's own part of it, ms of CPU."""
        return sum(share.own for share in self.shares)

    @property
    def part(self) -> float:
        """The whole scan as a part of the period."""
        return self.total / self.period

    def __str__(self) -> str:
        sources = [share for share in self.shares if share.requests]
        shares = list(self.shares)
        if len(sources) > _NAMED:
            slowest = max(share.device for share in sources)
            requests = sum(share.requests for share in sources)
            together = Share(f"{len(sources)} sources", sum(share.own for share in sources), slowest, requests)
            shares = [together, *(share for share in self.shares if not share.requests)]
        parts = "; ".join(map(str, shares))
        return f"task {self.task}: {_ms(self.total)} ms of {self.period:g} ms, {self.part:.0%}: {parts}"


def budgets(layout: Layout, costs: Costs = MEASURED) -> tuple[Budget, ...]:
    """The predicted budget of every task that has axes."""
    return tuple(_budget(task, layout, costs) for task in layout.tasks)


def warnings(found: tuple[Budget, ...]) -> Iterator[str]:
    """What will not do, or only just; nothing where there is room."""
    for budget in found:
        if budget.part <= MUCH:
            continue
        cure = f"expected a period_ms of {_ms(budget.total / MUCH)}, or fewer axes in this task"
        took = f"{_ms(budget.total)} ms of its {budget.period:g} ms, {budget.part:.0%}"
        if budget.own > budget.period:
            yield f"task {budget.task} cannot hold its period: a scan is predicted to take {took}; {cure}"
        elif budget.part > 1.0:
            late = "its sources answer after more than a period, so that not every scan has new values"
            yield f"task {budget.task} cannot hold its period: predicted {took}: {late}; {cure}"
        else:
            yield f"task {budget.task} is predicted to take {took}, so that scans will be late now and then; {cure}"
    load = sum(budget.own / budget.period for budget in found)
    if load > MUCH and len(found) > 1 and all(budget.part <= MUCH for budget in found):
        yield f"all tasks together are predicted to take {load:.0%} of the one core that the scan process has"


def explanation() -> str:
    """What the figures are worth."""
    return f"predicted from costs measured on {MACHINE}, with servers on the same machine; a PLC may answer later"


def _budget(task: TaskLayout, layout: Layout, costs: Costs) -> Budget:
    period = task.task.period_ms
    shares = [_source(source, period, costs) for source in task.sources]
    known = max(costs.observers.values(), key=lambda cost: cost.each)  # for a type that was not measured
    observers = sum(
        costs.observers.get(group.configs[0].type, known).of(len(group.places)) for group in task.observers
    )
    axes = sum(len(group.places) for group in task.observers)
    tags = layout.table.sections[task.section][2] - layout.table.sections[task.section][1]
    shares.append(Share(f"{axes} observer{'s' * (axes != 1)}", observers * _MS))
    shares.append(Share(f"{tags} published tags", (costs.scan + costs.publish.of(tags)) * _MS))
    return Budget(task.task.name, period, tuple(shares))


def _source(layout: SourceLayout, period: float, costs: Costs) -> Share:
    source: Any = layout.source
    tags = len(layout.readings)
    if source.type == "replay":
        return Share(f"{source.name} {tags} tags", costs.replay.of(tags) * _MS)
    if source.type == "opcua" and source.mode == "subscribe":
        sampling = source.sampling_ms if source.sampling_ms is not None else period
        changes = tags * period / max(sampling, 1.0)
        own = costs.opcua.once + changes * costs.subscribed
        return Share(f"{source.name} {tags} tags, subscribed, all changing", own * _MS)
    what = f"{source.name} {tags} tag{'s' * (tags != 1)}"
    if source.type == "opcua":
        requests = -(-tags // _READS)
        return Share(
            f"{what} in",
            _spread(costs.opcua, requests, tags),
            _spread(costs.opcua_device, requests, tags),
            requests,
        )
    asked = _modbus_requests(layout)
    device = _spread(costs.modbus_device, len(asked), tags)
    baudrate = getattr(source.transport, "baudrate", None)
    if baudrate is not None:
        device += sum(_FRAMING + request.size for request in asked) * _BITS / baudrate * 1e3
    return Share(f"{what} in", _spread(costs.modbus, len(asked), tags), device, len(asked))


def _spread(cost: Cost, requests: int, tags: int) -> float:
    """Milliseconds of so many requests that bring so many tags."""
    return (cost.once * requests + cost.each * tags) * _MS


def _modbus_requests(layout: SourceLayout) -> "tuple[Request, ...]":
    from softplc.drivers.modbus.driver import checked  # noqa: PLC0415  only where there is such a source
    from softplc.drivers.modbus.plan import Limits, plan  # noqa: PLC0415

    source: Any = layout.source
    limits = Limits(source.max_registers, source.max_bits, source.max_gap)
    return plan({checked(source, tag) for tag in layout.readings}, limits)


def _ms(milliseconds: float) -> str:
    """Two figures, and no exponent."""
    return f"{milliseconds:.0f}" if milliseconds >= 10.0 else f"{milliseconds:.2g}"
