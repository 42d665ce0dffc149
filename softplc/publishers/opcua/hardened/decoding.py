"""Decoding what clients send: a message must not make more than it holds, and one that is broken is told so.

As it comes, asyncua takes an array of a million Nulls, which have no bytes of their own, at its word: six bytes keep
the server busy for minutes. A request that cannot be decoded it answers with BadInternalError and a traceback in the
log. A number that is none of TimestampsToReturn breaks the whole message.
"""

from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.server import uaprocessor
from asyncua.ua import ua_binary

_unpack = ua_binary.unpack_uatype_array
_decode = ua_binary.struct_from_binary


def guard_decoding() -> None:
    """Have what cannot be, or must not be, decoded refused, in this process and for good."""
    ua_binary.unpack_uatype_array = _bounded
    uaprocessor.struct_from_binary = decoded
    ua.TimestampsToReturn._missing_ = lambda _: ua.TimestampsToReturn.Invalid


def decoded(kind: Any, data: Buffer) -> Any:
    """A structure of this kind. Raises ServiceError BadDecodingError, whatever it is that is wrong with the bytes."""
    try:
        return _decode(kind, data)
    except Exception as error:  # asyncua raises what comes: struct.error, TypeError, RecursionError, …
        raise ServiceError(ua.StatusCodes.BadDecodingError) from error


def _bounded(kind: ua.VariantType, data: Buffer) -> list[Any] | None:
    """Every element but a Null takes at least a byte, and nobody needs Nulls by the thousand. Raises UaError."""
    length = int.from_bytes(data.copy().read(4), "little", signed=True)
    if length > len(data):
        raise ua.UaError(f"array of {length} in a message with {len(data)} bytes left")
    values: list[Any] | None = _unpack(kind, data)
    return values
