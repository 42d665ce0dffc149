"""Decoding what clients send: a message must not make more than it holds.

As it comes, asyncua takes an array of a million Nulls, which have no bytes of their own, at its word: six bytes keep
the server busy for minutes.
"""

from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary

_unpack = ua_binary.unpack_uatype_array


def bound_arrays() -> None:
    """Have arrays that are longer than what is left of their message refused, in this process and for good."""
    ua_binary.unpack_uatype_array = _bounded


def _bounded(kind: ua.VariantType, data: Buffer) -> list[Any] | None:
    """Every element but a Null takes at least a byte, and nobody needs Nulls by the thousand. Raises UaError."""
    length = int.from_bytes(data.copy().read(4), "little", signed=True)
    if length > len(data):
        raise ua.UaError(f"array of {length} in a message with {len(data)} bytes left")
    values: list[Any] | None = _unpack(kind, data)
    return values
