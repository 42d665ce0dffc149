"""What a tag occupies in which device, told so that two spellings of one place are seen to be one."""

import ipaddress
import posixpath
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from softplc.config.checks_names import at
from softplc.config.checks_values import host_and_port
from softplc.config.facts import KEY_OF_KIND, Item, TagUse
from softplc.config.tree import Node, Scalar, below, text_at, where
from softplc.drivers.opcua.node import Address, BrowsePathAddress, NodeIdAddress

_OPCUA_PORT: Final = 4840
_MODBUS_PORT: Final = 502
_STANDARD: Final = "http://opcfoundation.org/UA/"  # the namespace that has index 0 in every server
_THIS_MACHINE: Final = ("localhost", "localhost.localdomain", "ip6-localhost", "ip6-loopback", "::1", "0.0.0.0", "::")


@dataclass(frozen=True, slots=True)
class Span:
    """What a tag occupies in its device: registers start … stop − 1 of a table, or one OPC-UA variable (0 … 0)."""

    device: tuple[Any, ...]
    table: Any
    start: int
    stop: int
    tag: TagUse
    label: str

    @property
    def places(self) -> range:
        """Its registers."""
        return range(self.start, self.stop)

    @property
    def line(self) -> int:
        """Line of the address."""
        return at(below(self.tag.block, key_of(self.tag)), self.tag.block)[0]

    @property
    def where(self) -> str:
        """Where the address stands, in words."""
        return where(below(self.tag.block, key_of(self.tag)) or self.tag.block)


def key_of(tag: TagUse) -> str:
    """The key that has the tag's address."""
    return KEY_OF_KIND.get(tag.kind or "", "source")


def by_table(spans: Iterable[Span]) -> dict[Any, list[Span]]:
    """The spans of each table of each device."""
    tables: dict[Any, list[Span]] = defaultdict(list)
    for span in spans:
        tables[span.device, span.table].append(span)
    return tables


def device_of(source: Item) -> tuple[Any, ...]:
    """What tells a device from others, so that one that is declared twice is known as the same."""
    if source.text("type") == "opcua":
        found = host_and_port(source.text("url") or "", _OPCUA_PORT)
        return ("opcua", _host(found[0]), found[1]) if found else ("source", source.name)
    transport = below(source.block, "transport")
    host, device = text_at(transport, "host"), text_at(transport, "device")
    port, unit = below(transport, "port"), below(source.block, "unit_id")
    if host is None and device is None:
        return ("source", source.name)
    where = posixpath.normpath(device) if device is not None else _host(host or "")
    return ("modbus", where, _MODBUS_PORT if port is None else _value(port), 1 if unit is None else _value(unit))


def canonical(address: Address) -> Address:
    """The address with the standard's namespace as index 0, which both spellings of it mean."""
    if isinstance(address, NodeIdAddress):
        return NodeIdAddress(_namespace(address.namespace), address.identifier)
    return BrowsePathAddress(tuple((_namespace(namespace), name) for namespace, name in address.steps))


def _namespace(namespace: int | str) -> int | str:
    return 0 if namespace == _STANDARD else namespace


def _host(text: str) -> str:
    """One spelling for each host. Names are not looked up: a name and its address stay two."""
    host = text.strip("[]").rstrip(".").lower()
    if host in _THIS_MACHINE:
        return "127.0.0.1"
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    mapped = getattr(address, "ipv4_mapped", None)
    return "127.0.0.1" if str(address) in _THIS_MACHINE else str(mapped or address)


def _value(node: Node | None) -> Any:
    return node.value if isinstance(node, Scalar) else None
