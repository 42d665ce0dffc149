"""One Read of always the same variables: encoded once, its answers decoded into the image."""

from collections.abc import Sequence

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from softplc.drivers.opcua.binding import Binding, read_value
from softplc.drivers.opcua.fast.plain import HEAD, SlowState, check_count, has_plain_head, has_plain_tail
from softplc.drivers.opcua.fast.records import NUMBERS, Layout
from softplc.drivers.opcua.fast.samples import BAD, MISMATCH, Samples
from softplc.drivers.opcua.fast.seam import decode_head, decode_message, decode_value
from softplc.drivers.opcua.session import Session, link_errors
from softplc.tags import NO_TIMESTAMP, Image


class ReadPlan:
    """One Read request for these bindings and the way of its answer into the image.

    `slow` counts what asyncua's decoder had to do. `max_age` in ms: how old a value the server may give, 0: none.
    """

    def __init__(self, session: Session, bindings: Sequence[Binding], slow: SlowState, max_age: float = 0.0) -> None:
        self.bindings = tuple(bindings)
        self._nodes = tuple(binding.node for binding in bindings)
        self._session = session
        self._slow = slow
        self._samples = Samples(len(bindings))
        self._noted = np.zeros(len(bindings), np.uint32)
        self._any_noted = False
        self._known_layout: Layout | None = None
        self._wrong: list[int] = []
        self._what = f"{session.url}: Read"
        uses = [(record, *use) for record, binding in enumerate(bindings) for use in binding.uses]
        plain = [(record, position) for record, position, index in uses if index is None]
        self._elements = [(record, position, index) for record, position, index in uses if index is not None]
        self._records = _slice_of([record for record, _ in plain])
        self._positions = where = _slice_of([position for _, position in plain])
        one_each = [record for record, _, _ in uses] == list(range(len(bindings)))
        self._direct = isinstance(where, slice) and one_each and not self._elements
        parameters = ua.ReadParameters(
            MaxAge=max_age,
            TimestampsToReturn=ua.TimestampsToReturn.Source,
            NodesToRead=[read_value(binding.node) for binding in bindings],
        )
        self._request = session.encode(ua.ReadRequest(Parameters=parameters), ua.ReadResponse)

    def renew(self) -> None:
        """The bindings were looked for anew: they are to be told what is wrong with them now."""
        self._noted[:] = 0
        self._any_noted = False
        self._known_layout = None

    def serves(self, bindings: Sequence[Binding]) -> bool:
        """True when this request asks for the nodes that these bindings have now."""
        return len(bindings) == len(self.bindings) and all(
            ours is theirs and theirs.node is node
            for ours, theirs, node in zip(self.bindings, bindings, self._nodes, strict=True)
        )

    async def read(self, into: Image) -> None:
        """Fill `into`. Raises LinkError."""
        with link_errors(self._what):
            body = await self._session.exchange(self._request)
            self.take(body, into, *self._session.arrival())

    def take(self, body: bytes, into: Image, arrival: float, now: int) -> None:
        """Put the answer's samples where the bindings use them; `now` where the server gives no timestamp.

        `arrival` is monotonic seconds, `now` ns UTC. Raises anything on an answer that makes no sense.
        """
        samples, where, direct = self._samples, self._positions, self._direct
        if direct:  # every record is one sample, and they follow each other in the image as in the answer
            samples.values, samples.statuses = into.values[where], into.statuses[where]
            samples.stamps = into.source_timestamps[where]
        self._decode(body)
        self._refuse_other_types()
        if not direct:
            records = self._records
            into.values[where] = samples.values[records]
            into.statuses[where] = samples.statuses[records]
            into.source_timestamps[where] = samples.stamps[records]
        if not samples.stamped:
            stamps = into.source_timestamps[where]
            into.source_timestamps[where] = np.where(stamps == NO_TIMESTAMP, now, stamps)
        into.arrivals[where] = arrival
        for record, position, index in self._elements:
            self._put_element(record, index, position, into, arrival, now)
        self._note()

    def _decode(self, body: bytes) -> None:
        """The samples of an answer. Raises anything on garbage, and then no sample was taken for one."""
        plain = has_plain_head(body)
        begin = check_count(body, HEAD if plain else decode_head(body), len(self._samples))

        def accept(end: int) -> None:
            if not plain or not has_plain_tail(body, end):
                self._slow.messages += 1
                decode_message(ua.ReadResponse, body)

        self._samples.decode(body, begin, decode_value, accept)
        self._slow.values += len(self._samples.odd)

    def _refuse_other_types(self) -> None:
        """What is no longer the kind of number that it was is BadTypeMismatch; types change with the layout."""
        samples = self._samples
        layout = samples.layout
        if layout is not self._known_layout and layout is not None:
            self._known_layout, self._wrong = layout, []
            for piece in layout.pieces:
                kind = piece.record.kind
                if kind in NUMBERS:
                    type_now = ua.VariantType(kind)
                    where = np.arange(len(samples))[piece.where].tolist()
                    self._wrong += [record for record in where if not self.bindings[record].accepts(type_now)]
        wrong = self._wrong
        if samples.odd:
            arrays = ((record, data.Value) for record, data in samples.odd.items() if data.Value is not None)
            wrong = wrong + [record for record, v in arrays if not self.bindings[record].accepts(v.VariantType)]
        for record in wrong:
            if not samples.statuses[record] & BAD:
                samples.values[record], samples.statuses[record] = np.nan, MISMATCH
                samples.odd.pop(record, None)

    def _put_element(self, record: int, index: int, position: int, into: Image, arrival: float, now: int) -> None:
        """One element of an array; a single value where an array was expected has the wrong type."""
        value, status, stamp = self._samples.element(record, index)
        into.values[position] = value
        into.statuses[position] = status
        into.source_timestamps[position] = now if stamp is None else stamp
        into.arrivals[position] = arrival

    def _note(self) -> None:
        """Tell the bindings of Bad statuses that came with this answer and not with the one before."""
        told = self._samples.told
        if told is None:
            if self._any_noted:
                self.renew()
            return
        changed = told != self._noted
        if changed.any():
            for record in np.flatnonzero(changed & ((told & BAD) != 0)):
                self.bindings[record].note(int(told[record]))
            self._noted[:] = told
            self._any_noted = True


def _slice_of(numbers: list[int]) -> slice | NDArray[np.intp]:
    """These indices, as a slice where they follow each other."""
    if numbers and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
        return slice(numbers[0], numbers[0] + len(numbers))
    return np.array(numbers, np.intp)
