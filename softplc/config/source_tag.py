"""A tag of a source as a model, whatever its protocol; and what Enable may be."""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Tag

from softplc.drivers.modbus.config import ModbusTag
from softplc.drivers.opcua.config import OpcUaTag
from softplc.drivers.replay import ReplayTag
from softplc.model import Model


def _protocol_of(tag: Any) -> str | None:
    """A tag is of the protocol whose key it has: node, address or column."""
    for key, protocol in (("node", "opcua"), ("address", "modbus"), ("column", "replay")):
        if (key in tag) if isinstance(tag, dict) else hasattr(tag, key):
            return protocol
    return None


SourceTag = Annotated[
    Annotated[OpcUaTag, Tag("opcua")] | Annotated[ModbusTag, Tag("modbus")] | Annotated[ReplayTag, Tag("replay")],
    Discriminator(
        _protocol_of,
        custom_error_type="source_tag",
        custom_error_message="a tag: source, and one of node (OPC-UA), address (Modbus) or column (recording)",
    ),
]


class WritableEnable(Model):
    """Enable is a tag that a client may write (see the OPC-UA publisher's users)."""

    writable: Literal[True]
    """Clients that have logged in may write it."""
    initial: bool = True
    """State after start."""


def _form_of_enable(value: Any) -> str | None:
    """Of the three forms of enable the one that a value has."""
    if isinstance(value, bool):
        return "state"
    if isinstance(value, WritableEnable) or (isinstance(value, dict) and "writable" in value):
        return "writable"
    return _protocol_of(value)


Enable = Annotated[
    Annotated[bool, Tag("state")]
    | Annotated[WritableEnable, Tag("writable")]
    | Annotated[OpcUaTag, Tag("opcua")]
    | Annotated[ModbusTag, Tag("modbus")]
    | Annotated[ReplayTag, Tag("replay")],
    Discriminator(
        _form_of_enable,
        custom_error_type="enable",
        custom_error_message="true, false, writable: true, or a tag: source, and one of node, address or column",
    ),
]
