"""Which tags a Read request asks for, found in its bytes; None wherever it is not a plain Read of tags' values."""

import struct
from collections import OrderedDict
from typing import Any, Final, NamedTuple

import numpy as np
from asyncua import ua
from asyncua.ua.ua_binary import nodeid_to_binary
from numpy.typing import NDArray

from softplc.publishers.opcua.address_space import NAMESPACE
from softplc.tags import TagTable

READ: Final[bytes] = nodeid_to_binary(ua.ReadRequest().TypeId)
_HEAD: Final = struct.Struct("<8xI4xi4x3s")
"""Timestamp, handle, diagnostics wanted, audit entry, timeout, additional header (OPC 10000-4, 7.33)."""
_WHAT: Final = struct.Struct("<dI")
"""MaxAge and TimestampsToReturn."""
_STAMPS: Final = 4
_NO_TEXTS: Final = (-1, 0)
_COUNT: Final = 4
_STRING_ID: Final = b"\x03" + NAMESPACE.to_bytes(2, "little")
_LENGTH: Final = 4
_NONE: Final = (b"\xff\xff\xff\xff", b"\0\0\0\0")
_VALUE: Final = int(ua.AttributeIds.Value).to_bytes(4, "little")
_TAILS: Final = frozenset(_VALUE + indices + b"\0\0" + encoding for indices in _NONE for encoding in _NONE)
_TAIL: Final = 14  # attribute, no index range, no data encoding

Tags = NDArray[np.intp]


class Head(NamedTuple):
    """Request handle, TimestampsToReturn, and where what is asked for begins: with TimestampsToReturn, the nodes."""

    handle: int
    stamps: int
    what: int
    nodes: int


def parse_head(body: bytes, token: bytes) -> Head | None:
    """The head of a Read in the session with this token."""
    at = len(READ) + len(token)
    if not body.startswith(READ + token) or len(body) < at + _HEAD.size + _WHAT.size:
        return None
    handle, audit, additional = _HEAD.unpack_from(body, at)
    max_age, stamps = _WHAT.unpack_from(body, at + _HEAD.size)
    if audit not in _NO_TEXTS or additional != b"\0\0\0" or not max_age >= 0.0 or stamps > 3:
        return None
    nodes = at + _HEAD.size + _WHAT.size
    return Head(handle, stamps, nodes - _STAMPS, nodes)


def parse_nodes(nodes: bytes, table: TagTable, most: int) -> Tags | None:
    """The indices of the tags whose values are asked for; `nodes` is NodesToRead and all that follows."""
    count = int.from_bytes(nodes[:_COUNT], "little", signed=True)
    if not 0 < count <= most:
        return None
    found, at = [], _COUNT
    try:
        for _ in range(count):
            begin = at + len(_STRING_ID) + _LENGTH
            end = begin + int.from_bytes(nodes[begin - _LENGTH : begin], "little", signed=True)
            at = max(end, begin) + _TAIL
            if not nodes.startswith(_STRING_ID, begin - _LENGTH - len(_STRING_ID)) or nodes[end:at] not in _TAILS:
                return None
            found.append(table.index(nodes[begin:end].decode()))
    except (KeyError, UnicodeDecodeError):
        return None
    return np.array(found, np.intp) if at == len(nodes) else None


class Remembered:
    """What the last requests asked for, by their bytes; no more than so many bytes of them."""

    def __init__(self, most_bytes: int) -> None:
        self._most = most_bytes
        self._held = 0
        self._found: OrderedDict[bytes, Any] = OrderedDict()

    def __len__(self) -> int:
        return len(self._found)

    def get(self, nodes: bytes) -> Any:
        """What was put for these bytes, or None."""
        found = self._found.get(nodes)
        if found is not None:
            self._found.move_to_end(nodes)
        return found

    def put(self, nodes: bytes, found: Any) -> None:
        """Remember; those that were not asked for the longest are forgotten."""
        self._found[nodes] = found
        self._held += len(nodes)
        while self._held > self._most:
            self._held -= len(self._found.popitem(last=False)[0])
