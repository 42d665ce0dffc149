"""Types of variables: what the server declares, and what kind of number each was when its source was first read.

A PLC program that has DINT where REAL was may count in other units: the number that comes is right, and means
something else. So another kind than the first is not taken. INT and DINT, or REAL and LREAL, are the same kind. What
was seen first is kept as long as the source's configuration: over every connection, until softplc starts anew.
"""

from typing import Final
from weakref import WeakKeyDictionary

from asyncua import ua

from softplc.drivers.opcua.config import OpcUaSource
from softplc.drivers.opcua.node import Address
from softplc.drivers.opcua.session import Session
from softplc.drivers.opcua.values import INTEGER_RANGES

BOOLEAN, INTEGER, REAL = "Boolean", "integer", "floating point"
_KINDS: Final = {
    ua.VariantType.Boolean: BOOLEAN,
    ua.VariantType.Float: REAL,
    ua.VariantType.Double: REAL,
    **dict.fromkeys(INTEGER_RANGES, INTEGER),
}

FirstTypes = dict[Address, ua.VariantType]
"""Type of each variable as first seen; one that is no number is not seen."""

_FIRST: WeakKeyDictionary[OpcUaSource, FirstTypes] = WeakKeyDictionary()


def first_types(source: OpcUaSource) -> FirstTypes:
    """The memory of a source, the same one for all its connections."""
    return _FIRST.setdefault(source, {})


def same_kind(first: ua.VariantType, now: ua.VariantType) -> bool:
    """True when both are integers, both floating point or both Boolean."""
    return _KINDS.get(first) == _KINDS.get(now)


def plain_node(node: ua.ExpandedNodeId) -> ua.NodeId | None:
    """The node id without the expansions; None for a node of another server."""
    if getattr(node, "ServerIndex", 0):
        return None
    return ua.NodeId(node.Identifier, node.NamespaceIndex, node.NodeIdType)


_ABSTRACT: Final = {
    ua.ObjectIds.Number: ua.VariantType.Double,
    ua.ObjectIds.Integer: ua.VariantType.Int64,
    ua.ObjectIds.UInteger: ua.VariantType.UInt64,
    ua.ObjectIds.Enumeration: ua.VariantType.Int32,
}


async def base_type(session: Session, data_type: ua.NodeId, depth: int = 10) -> ua.VariantType | None:
    """The built-in type that a data type derives from; None when the server does not tell."""
    for _ in range(depth):
        if data_type.NamespaceIndex == 0 and isinstance(data_type.Identifier, int):
            if data_type.Identifier in _ABSTRACT:
                return _ABSTRACT[data_type.Identifier]
            if 1 <= data_type.Identifier <= 23:
                return ua.VariantType(data_type.Identifier)
        description = ua.BrowseDescription(
            NodeId=data_type,
            BrowseDirection=ua.BrowseDirection.Inverse,
            ReferenceTypeId=ua.NodeId(ua.ObjectIds.HasSubtype),
            IncludeSubtypes=False,
            ResultMask=ua.BrowseResultMask.None_,
        )
        (result,) = await session.browse([description], 1)
        if not result.References:
            return None
        data_type = plain_node(result.References[0].NodeId) or ua.NodeId()
    return None
