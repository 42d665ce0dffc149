"""Which requests read a set of values: as few as the device's limits allow, never splitting a value. Pure."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

from softplc.drivers.modbus.address import Address, Table


@dataclass(frozen=True, slots=True, order=True)
class Span:
    """The registers (or bits) that one value occupies: `length` of them from offset `start` of a table."""

    table: Table
    start: int
    length: int

    @property
    def stop(self) -> int:
        """Offset after the last one."""
        return self.start + self.length


@dataclass(frozen=True, slots=True)
class Limits:
    """What may be asked of a device in one request, and how much that nobody declared may be read along.

    `max_gap` counts registers between two values of one request, in the bit tables bits.
    """

    max_registers: int = 125
    max_bits: int = 2000
    max_gap: int = 8

    def of(self, table: Table) -> int:
        """Most registers or bits of this table in one request."""
        return self.max_bits if table.bits else self.max_registers


@dataclass(frozen=True, slots=True)
class Request:
    """One read request: `count` registers or bits from `start`, and the values that it brings, sorted, none twice."""

    table: Table
    start: int
    count: int
    spans: tuple[Span, ...]

    @property
    def size(self) -> int:
        """How many bytes of data the reply carries."""
        return (self.count + 7) // 8 if self.table.bits else 2 * self.count

    def __str__(self) -> str:
        """As a person would look it up: first address in both notations, and how many."""
        first = Address(self.table, self.start)
        return str(first) if self.count == 1 else f"{first} and the next {self.count - 1}"


def plan(spans: Iterable[Span], limits: Limits) -> tuple[Request, ...]:
    """The fewest requests that read every span whole, table by table in ascending order.

    Neighbours share a request as long as it stays within the limit and the gap between them within `max_gap`;
    spans that overlap share where they fit. A span alone always gets its request, so its length must be within
    the limit: raises ValueError otherwise.
    """
    requests: list[Request] = []
    for table, group in groupby(sorted(set(spans)), key=lambda span: span.table):
        requests += (_request(table, run) for run in _runs(group, limits.of(table), limits.max_gap))
    return tuple(requests)


def split(request: Request, limits: Limits) -> tuple[Request, ...]:
    """The parts to ask for instead of a request that the device refused as a whole; none if it is a single value.

    First the same values without what nobody declared between them; when there is no such gap, two halves. Asked
    again in turn, the values that the device does give end in few requests, those that it does not give alone.
    """
    if len(request.spans) == 1:
        return ()
    tight = Limits(limits.max_registers, limits.max_bits, max_gap=0)
    parts = plan(request.spans, tight)
    if len(parts) > 1:
        return parts
    middle = len(request.spans) // 2
    return plan(request.spans[:middle], tight) + plan(request.spans[middle:], tight)


def _runs(spans: Iterable[Span], limit: int, max_gap: int) -> Iterator[list[Span]]:
    """Greedy from the lowest offset: the leftmost span must be read, and no request that reads it reaches further."""
    run: list[Span] = []
    stop = 0
    for span in spans:
        if span.length > limit:
            raise ValueError(f"a value of {span.length} registers cannot be read with at most {limit} in one request")
        if run and span.start - stop <= max_gap and max(stop, span.stop) - run[0].start <= limit:
            run.append(span)
            stop = max(stop, span.stop)
        else:
            if run:
                yield run
            run, stop = [span], span.stop
    if run:
        yield run


def _request(table: Table, run: list[Span]) -> Request:
    start = run[0].start
    return Request(table, start, max(span.stop for span in run) - start, tuple(run))
