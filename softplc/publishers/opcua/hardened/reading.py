"""Read, where it is no plain Read of tags' values (OPC 10000-4, 5.11.2)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import ServiceError

from softplc.publishers.opcua.hardened.parts import part_of
from softplc.publishers.opcua.values import stamped

STAMPS: Final = tuple(ua.TimestampsToReturn)[:4]
"""Those that may be asked for."""
_READ_WRITE: Final = 1 << ua.AccessLevel.CurrentRead | 1 << ua.AccessLevel.CurrentWrite


def check_read(params: Any) -> None:
    """Raises ServiceError when MaxAge or TimestampsToReturn is none."""
    if not params.MaxAge >= 0.0:  # NaN too
        raise ServiceError(ua.StatusCodes.BadMaxAgeInvalid)
    if params.TimestampsToReturn not in STAMPS:
        raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)


def results_of(params: Any, values: Sequence[Any], may_write: Callable[[Any], bool]) -> list[Any]:
    """What is asked for of these values: parts and timestamps, and UserAccessLevel as it is for this user.

    asyncua: always all of the value, with both timestamps.
    """
    return [
        stamped(part_of(_own(value, asked, may_write), asked), params.TimestampsToReturn)
        for value, asked in zip(values, params.NodesToRead, strict=True)
    ]


def _own(value: Any, asked: Any, may_write: Callable[[Any], bool]) -> Any:
    if asked.AttributeId != ua.AttributeIds.UserAccessLevel or not may_write(asked.NodeId):
        return value
    return replace(value, Value=ua.Variant(_READ_WRITE, ua.VariantType.Byte))
