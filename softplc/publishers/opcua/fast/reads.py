"""Reads of the tags' values, answered out of the arrays."""

import struct
from typing import Any, Final, NamedTuple

import numpy as np
from asyncua import ua
from asyncua.ua.ua_binary import nodeid_to_binary, struct_to_binary
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.publishers.opcua.fast.encoding import classes_of, encode, ticks, with_timestamps
from softplc.publishers.opcua.fast.requests import READ, Head, Remembered, Tags, parse_head, parse_nodes
from softplc.publishers.opcua.values import TagValues

_REMEMBERED_BYTES: Final = 4 << 20
_STAMP_AND_HANDLE: Final = struct.Struct("<qI")
_EMPTY: Final[bytes] = struct_to_binary(ua.ReadResponse())
_TYPE: Final = nodeid_to_binary(ua.ReadResponse().TypeId)
_COUNT: Final = 4  # bytes of the number of results, and of that of the diagnostics after them
_AFTER_HANDLE: Final = _EMPTY[len(_TYPE) + _STAMP_AND_HANDLE.size : -2 * _COUNT]
_NO_DIAGNOSTICS: Final = _EMPTY[-_COUNT:]


class Answer(NamedTuple):
    """The handle of a request, and the plain body of its response."""

    handle: int
    body: bytes


class Reads:
    """Answers Reads that ask for nothing but tags' values. `served` counts them; `slow` those that others answer.

    `most` is the number of nodes that one request may ask for.
    """

    def __init__(self, values: TagValues, clock: Clock, most: int) -> None:
        self._values, self._clock, self._most = values, clock, most
        self._classes = classes_of(values.table)
        self._remembered = Remembered(_REMEMBERED_BYTES)
        self.served = 0
        self.slow = 0

    def answer(self, body: bytes, token: Any) -> Answer | None:
        """The response to this request of the session with this token; None when it is not one to answer here."""
        if not body.startswith(READ):
            return None
        head = parse_head(body, nodeid_to_binary(token))
        found = None if head is None else self._tags(head, body)
        if head is None or found is None:
            self.slow += 1
            return None
        self.served += 1
        tags, classes = found
        values = self._values
        results = encode(
            classes,
            values.values[tags],
            values.statuses[tags],
            values.source_timestamps[tags],
            values.server_timestamp,
        )
        stamp_and_handle = _STAMP_AND_HANDLE.pack(ticks(self._clock.utc_ns()), head.handle)
        count = len(tags).to_bytes(_COUNT, "little")
        return Answer(
            head.handle, b"".join((_TYPE, stamp_and_handle, _AFTER_HANDLE, count, results, _NO_DIAGNOSTICS))
        )

    def _tags(self, head: Head, body: bytes) -> tuple[Tags, NDArray[np.uint8]] | None:
        """Indices and classes of the tags that are asked for."""
        what = body[head.what :]
        found: tuple[Tags, NDArray[np.uint8]] | None = self._remembered.get(what)
        if found is None:
            tags = parse_nodes(body[head.nodes :], self._values.table, self._most)
            if tags is not None:
                found = tags, with_timestamps(self._classes[tags], np.uint8(head.stamps))
                self._remembered.put(what, found)
        return found
