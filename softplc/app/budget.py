"""How much of its period each task will take: a prediction from the configuration and the measured costs; no I/O."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal

from softplc.app.costs import MACHINE, MEASURED, Cost, Costs
from softplc.app.layout import Layout, SourceLayout, TaskLayout
from softplc.scan import READ_BUDGET

if TYPE_CHECKING:
    from softplc.drivers.modbus.plan import Request

MUCH: Final = 0.5  # of the period; beyond it the next thing that takes the processor makes a scan late
_READS: Final = 5000  # tags of one OPC-UA Read where the server takes no fewer
_NAMED: Final = 3  # sources that are shown one by one
Basis = Literal["assumed", "line", "measured"]
Answers = Mapping[tuple[str, str], float]  # ms that a read took, by task and source
_MS: Final = 1e-3  # of a µs
_BITS: Final = 11.0  # of a byte on a serial line
_FRAMING: Final = 8 + 5 + 7  # bytes of a request, of an answer beside its data, and of the silences around them


@dataclass(frozen=True, slots=True)
class Share:
    """A part of a scan: `own` is softplc's time, `device` what it waits for the answers to its requests, ms.

    `source` is whose answers they are and `basis` what `device` rests on; where that is assumed, `like` says whose
    answers it is taken from. `cure`: what makes the wait shorter, beside fewer tags.
    """

    what: str
    own: float
    device: float = 0.0
    requests: int = 0
    source: str = ""
    basis: Basis = "assumed"
    like: str = ""
    cure: str = ""

    def __str__(self) -> str:
        if not self.requests:
            return f"{self.what} {_ms(self.own)}"
        asked = "1 request" if self.requests == 1 else f"{self.requests} requests"
        return f"{self.what} {asked}, {_ms(self.own)} + {_ms(self.device)} until the answer ({self.basis})"


@dataclass(frozen=True, slots=True)
class Budget:
    """One task's scan: its period and its parts, ms. Sources answer side by side, so the slowest is waited for."""

    task: str
    period: float
    shares: tuple[Share, ...]

    @property
    def own(self) -> float:
        """softplc's own part of the scan, ms of CPU."""
        return sum(share.own for share in self.shares)

    @property
    def part(self) -> float:
        """softplc's own part of the scan as a part of the period."""
        return self.own / self.period

    @property
    def slowest(self) -> Share:
        """The one whose answer is waited for the longest."""
        return max(self.shares, key=lambda share: share.device)

    @property
    def total(self) -> float:
        """The whole scan if it waited for every answer, ms."""
        return self.own + self.slowest.device

    def __str__(self) -> str:
        sources = [share for share in self.shares if share.requests]
        shares = list(self.shares)
        if len(sources) > _NAMED:
            requests, taken = sum(share.requests for share in sources), sum(share.own for share in sources)
            together = replace(self.slowest, what=f"{len(sources)} sources in", own=taken, requests=requests)
            shares = [together, *(share for share in self.shares if not share.requests)]
        answer = f", and {_ms(self.slowest.device)} ms until the answer" if sources else ""
        took = f"{_ms(self.own)} ms of {self.period:g} ms, {self.part:.0%}"
        return f"task {self.task}: softplc's own share is {took}{answer}: {'; '.join(map(str, shares))}"


def budgets(layout: Layout, costs: Costs = MEASURED, answers: Answers | None = None) -> tuple[Budget, ...]:
    """The predicted budget of every task that has axes; `answers` are those that were measured."""
    return tuple(_budget(task, layout, costs, answers or {}) for task in layout.tasks)


def warnings(found: tuple[Budget, ...]) -> Iterator[str]:
    """What will not do, or only just; nothing where there is room."""
    for budget in found:
        took = f"{_ms(budget.own)} ms of its {budget.period:g} ms"
        share = f"softplc's own share of a scan is predicted to take {took}"
        cure = f"expected a period_ms of {_rounded_up(budget.own / MUCH)}, or fewer axes in this task"
        if budget.own > budget.period:
            yield f"task {budget.task} cannot hold its period: {share}, {budget.part:.0%}; {cure}"
        elif budget.part > MUCH:
            yield f"task {budget.task}: {share}, more than half, so that scans will be late now and then; {cure}"
        elif budget.total > MUCH * budget.period:
            yield f"task {budget.task}: {_late(budget)}"
    load = sum(budget.part for budget in found)
    if load > MUCH and len(found) > 1 and all(budget.part <= MUCH for budget in found):
        yield f"all tasks together are predicted to take {load:.0%} of the one core that the scan process has"


def _late(budget: Budget) -> str:
    """What an answer does that takes more of a period than will do, where softplc's own share fits."""
    share, period, took = budget.slowest, f"{budget.period:g} ms", _ms(budget.slowest.device)
    if share.basis == "measured":
        text = f"the answer of {share.source} was measured to take {took} ms, so that"
    elif share.basis == "line":
        text = f"the answer of {share.source} takes {took} ms on its line, so that"
    else:
        text = f"if {share.source} answers like {share.like}, it takes {took} ms, and"
    if share.device > READ_BUDGET * budget.period:
        text += f" a scan waits {_ms(READ_BUDGET * budget.period)} ms of its {period} and goes on with older values"
    else:
        text += f" a scan takes {_ms(budget.total)} ms of its {period}, more than half, and will be late now and then"
    cures = (f"a period_ms of {_rounded_up(budget.total / MUCH)}", share.cure, f"fewer tags of {share.source}")
    text += f"; softplc's own share fits, {budget.part:.0%}; expected then {' or '.join(filter(None, cures))}"
    return text + ("; check --connect measures the answer" if share.basis == "assumed" else "")


def explanation(*, measured: bool = False) -> str:
    """What the figures are worth."""
    own = f"softplc's own share is predicted from costs measured on {MACHINE}; "
    if measured:
        return own + "the answers are medians of what was just read"
    return own + "the answers are assumed to be those of servers beside it: check --connect measures them"


def _budget(task: TaskLayout, layout: Layout, costs: Costs, answers: Answers) -> Budget:
    period, name = task.task.period_ms, task.task.name
    shares = [_source(source, period, costs) for source in task.sources]
    for number, share in enumerate(shares):
        answer = answers.get((name, share.source))
        if share.requests and answer is not None:
            shares[number] = replace(share, device=max(answer - share.own, 0.0), basis="measured")
    known = max(costs.observers.values(), key=lambda cost: cost.each)  # for a type that was not measured
    observers = sum(
        costs.observers.get(group.configs[0].type, known).of(len(group.places)) for group in task.observers
    )
    axes = sum(len(group.places) for group in task.observers)
    tags = layout.table.sections[task.section][2] - layout.table.sections[task.section][1]
    shares.append(Share(f"{axes} observer{'s' * (axes != 1)}", observers * _MS))
    shares.append(Share(f"{tags} published tags", (costs.scan + costs.publish.of(tags)) * _MS))
    return Budget(name, period, tuple(shares))


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
        own, device = _spread(costs.opcua, requests, tags), _spread(costs.opcua_device, requests, tags)
        like = f"a server in node.js beside it, {costs.opcua_device.each:g} µs a tag"
        return Share(f"{what} in", own, device, requests, source.name, like=like, cure="mode: subscribe")
    asked = _modbus_requests(layout)
    at_once = source.in_flight if source.transport.type == "tcp" else 1
    turns = -(-len(asked) // at_once)
    own = _spread(costs.modbus, len(asked), tags) + turns * costs.modbus_turn * _MS
    device = _spread(costs.modbus_device, turns, tags)
    baudrate = getattr(source.transport, "baudrate", None)
    if baudrate is None:
        like = f"an emulated PLC beside it, {costs.modbus_device.once:g} µs a request"
        more = source.transport.type == "tcp" and turns > 1
        cure = "a higher in_flight (if the device can do that)" if more else ""
        return Share(f"{what} in", own, device, len(asked), source.name, like=like, cure=cure)
    device += sum(_FRAMING + request.size for request in asked) * _BITS / baudrate * 1e3
    return Share(f"{what} in", own, device, len(asked), source.name, "line")


def _spread(cost: Cost, requests: int, tags: int) -> float:
    """Milliseconds of so many requests that bring so many tags."""
    return (cost.once * requests + cost.each * tags) * _MS


def _modbus_requests(layout: SourceLayout) -> "tuple[Request, ...]":
    from softplc.drivers.modbus.driver import checked  # noqa: PLC0415  only where there is such a source
    from softplc.drivers.modbus.plan import Limits, plan  # noqa: PLC0415

    source: Any = layout.source
    limits = Limits(source.max_registers, source.max_bits, source.max_gap)
    return plan({checked(source, tag) for tag in layout.readings}, limits)


def _rounded_up(milliseconds: float) -> str:
    """At least so much: whole milliseconds, or below ten of them tenths."""
    return f"{math.ceil(milliseconds)}" if milliseconds > 9.9 else f"{math.ceil(10.0 * milliseconds) / 10.0:g}"


def _ms(milliseconds: float) -> str:
    """Two figures, and no exponent."""
    return f"{milliseconds:.0f}" if milliseconds >= 10.0 else f"{milliseconds:.2g}"
