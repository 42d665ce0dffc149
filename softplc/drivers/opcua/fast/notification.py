"""Changes that a subscription reports, decoded into the image all at once.

Behind the head of a PublishResponse (OPC 10000-4, 5.14.5, 7.25): the subscription's id, the available sequence
numbers, whether more follows, sequence number and time of the message; then its notifications, each an
ExtensionObject, and the results of the acknowledgements. What is not one DataChangeNotification, nor an empty
keep-alive, is left to asyncua's decoder.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from asyncua import ua
from asyncua.ua.ua_binary import nodeid_to_binary
from numpy.typing import NDArray

from softplc.drivers.opcua.binding import Binding
from softplc.drivers.opcua.fast.plain import HEAD, NONE, has_plain_head
from softplc.drivers.opcua.fast.records import HANDLE, NUMBERS, OddBodyError
from softplc.drivers.opcua.fast.samples import BAD, MISMATCH, Samples
from softplc.drivers.opcua.fast.seam import decode_value
from softplc.drivers.opcua.session import Session, link_errors
from softplc.tags import NO_TIMESTAMP, Image

_CHANGES: Final = nodeid_to_binary(ua.NodeId(ua.ObjectIds.DataChangeNotification_Encoding_DefaultBinary)) + b"\x01"
_COUNT: Final = struct.Struct("<i")
_MESSAGE: Final = struct.Struct("<?Iqi")  # more follows, sequence number, time, notifications
_MOST: Final = 1_000_000  # items in a message: more are nonsense
_SMALLEST_ITEM: Final = HANDLE + 1


@dataclass(frozen=True, slots=True)
class Published:
    """What a PublishResponse holds: `items` changes from byte `start` to `end` of its body; a keep-alive has none."""

    subscription: int
    number: int
    keep_alive: bool
    items: int = 0
    start: int = 0
    end: int = 0


async def publish(session: Session, acknowledgements: Sequence[ua.SubscriptionAcknowledgement]) -> bytes:
    """As the session's own, with the body of the answer as it came. Raises LinkError."""
    parameters = ua.PublishParameters(SubscriptionAcknowledgements=list(acknowledgements))
    with link_errors(f"{session.url}: Publish"):
        request = session.encode(ua.PublishRequest(Parameters=parameters), ua.PublishResponse, timed=False)
        return await session.exchange(request)


def read_published(body: bytes) -> Published | None:
    """The frame of a message, or None when it is not a plain one."""
    try:
        return _read_published(body) if has_plain_head(body) else None
    except (struct.error, IndexError):
        return None


def _read_published(body: bytes) -> Published | None:
    (subscription, available), at = struct.unpack_from("<Ii", body, HEAD), HEAD + 8
    at += 4 * max(available, 0)
    more, number, _, notifications = _MESSAGE.unpack_from(body, at)
    del more
    at += _MESSAGE.size
    if notifications in (-1, 0):
        return Published(subscription, number, keep_alive=True) if _is_tail(body, at) else None
    if notifications != 1 or not body.startswith(_CHANGES, at):
        return None
    at += len(_CHANGES)
    length, items = struct.unpack_from("<ii", body, at)
    start, end = at + 8, at + 4 + length
    if not 0 <= items <= min(_MOST, (end - start) // _SMALLEST_ITEM) or end > len(body) or not _is_tail(body, end):
        return None
    return Published(subscription, number, False, items, start, end)


def _is_tail(body: bytes, at: int) -> bool:
    """Whether results and no diagnostics are all that follows."""
    (results,) = _COUNT.unpack_from(body, at)
    end = at + 4 + 4 * max(results, 0)
    return body[end:] in NONE


class Changes:
    """The way of reported changes into `latest`: client handles are positions among the readings.

    `skipped` counts samples that a newer one of the same message superseded, and queues that overflowed.
    """

    def __init__(self, readings: Sequence[Binding], latest: Image) -> None:
        self._readings, self._latest = readings, latest
        self.values = 0  # that asyncua decoded, one by one
        uses = [(handle, *use) for handle, binding in enumerate(readings) for use in binding.uses]
        plain = [(handle, position) for handle, position, index in uses if index is None]
        self._use_handles = np.array([handle for handle, _ in plain], np.intp)
        self._use_positions = np.array([position for _, position in plain], np.intp)
        self._elements: dict[int, list[tuple[int, int]]] = {}
        for handle, position, index in uses:
            if index is not None:
                self._elements.setdefault(handle, []).append((position, index))
        self._record_of: NDArray[np.intp] = np.full(len(readings), -1, np.intp)
        self._accepted = np.zeros(len(readings), np.uint8)  # type that each was last, where it is one to take
        self.skipped = 0

    def take(self, body: bytes, message: Published, arrival: float, now: int) -> list[int]:
        """Put the newest sample of each handle into the image; returns the handles. Raises OddBodyError.

        `arrival` is monotonic seconds, `now` ns UTC where the server gives no timestamp.
        """
        samples = Samples(message.items, HANDLE)
        samples.decode(body, message.start, decode_value, lambda end: _accept(body, end, message.end))
        assert samples.handles is not None
        if message.items and int(samples.handles.max()) >= len(self._readings):
            raise OddBodyError(f"was told of item {int(samples.handles.max())}, which is not ours")
        self._refuse_other_types(samples, samples.handles.astype(np.intp))
        newest = _newest(samples.handles.astype(np.intp), self._record_of)
        handles = samples.handles[newest].astype(np.intp)
        self.skipped += message.items - len(newest)
        if samples.overflowed is not None:
            self.skipped += int(samples.overflowed[newest].sum())
        self.values += len(samples.odd)
        record_of = self._record_of
        record_of.fill(-1)
        record_of[handles] = newest
        self._put(samples, record_of[self._use_handles], arrival, now)
        if self._elements:
            self._put_elements(samples, newest, handles, arrival, now)
        if samples.told is not None:
            told = samples.told[newest]
            for place in np.flatnonzero(told & BAD):
                self._readings[handles[place]].note(int(told[place]))
        found: list[int] = handles.tolist()
        return found

    def _refuse_other_types(self, samples: Samples, handles: NDArray[np.intp]) -> None:
        """What is no longer the kind of number that it was is BadTypeMismatch."""
        wrong: list[int] = []
        for piece in samples.layout.pieces if samples.layout is not None else ():
            kind = piece.record.kind
            if kind in NUMBERS:
                records = np.arange(len(handles))[piece.where]
                for record in records[self._accepted[handles[records]] != kind].tolist():
                    if self._readings[handles[record]].accepts(ua.VariantType(kind)):
                        self._accepted[handles[record]] = kind
                    else:
                        wrong.append(record)
        for record, data in samples.odd.items():
            if data.Value is not None and not self._readings[handles[record]].accepts(data.Value.VariantType):
                wrong.append(record)
        for record in wrong:
            if not samples.statuses[record] & BAD:
                samples.values[record], samples.statuses[record] = np.nan, MISMATCH
                samples.odd.pop(record, None)

    def _put(self, samples: Samples, records: NDArray[np.intp], arrival: float, now: int) -> None:
        latest, told_of = self._latest, records >= 0
        where, records = self._use_positions[told_of], records[told_of]
        latest.values[where] = samples.values[records]
        latest.statuses[where] = samples.statuses[records]
        stamps = samples.stamps[records]
        latest.source_timestamps[where] = np.where(stamps == NO_TIMESTAMP, now, stamps)
        latest.arrivals[where] = arrival

    def _put_elements(
        self, samples: Samples, newest: NDArray[np.intp], handles: NDArray[np.intp], arrival: float, now: int
    ) -> None:
        latest = self._latest
        for record, handle in zip(newest, handles, strict=True):
            for position, index in self._elements.get(int(handle), ()):
                value, status, stamp = samples.element(int(record), index)
                latest.values[position] = value
                latest.statuses[position] = status
                latest.source_timestamps[position] = now if stamp is None else stamp
                latest.arrivals[position] = arrival


def _accept(body: bytes, end: int, wanted: int) -> None:
    if body[end:wanted] not in NONE:
        raise OddBodyError("the notification has diagnostics, or another length")


def _newest(handles: NDArray[np.intp], marks: NDArray[np.intp]) -> NDArray[np.intp]:
    """Of each handle the last record; items of one tag are in the order of their sampling."""
    records = np.arange(len(handles))
    marks[handles] = records
    if np.array_equal(marks[handles], records):
        return records
    _, last = np.unique(handles[::-1], return_index=True)
    return np.sort(len(handles) - 1 - last)
