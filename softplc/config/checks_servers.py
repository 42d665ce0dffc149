"""Publishers: one port for each, none of them a source, axis blocks that fit into the register map, certificates."""

from collections.abc import Iterator
from typing import Any, Final

from pydantic import ValidationError

from softplc.config.checks_names import at, task_names
from softplc.config.checks_values import host_and_port
from softplc.config.facts import Facts, Item
from softplc.config.problem import LONG, Problem, shown
from softplc.config.tree import Scalar, below, items_at, text_at
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.modbus.placement import AXES, REGISTERS, PlacementError, place
from softplc.publishers.opcua.config import OpcUaPublisher, OpcUaServerSecurity

_DEFAULTS: Final[dict[str, Any]] = {"opcua": OpcUaPublisher, "modbus": ModbusPublisher}
_EVERYWHERE: Final = ("0.0.0.0", "::", "")
_LOCAL: Final = {"localhost": "127.0.0.1", "ip6-localhost": "::1"}


def check(facts: Facts) -> Iterator[Problem]:
    """All problems with publishers."""
    yield from _ports(facts)
    for publisher in facts.publishers:
        if publisher.text("type") == "modbus":
            yield from _places(facts, publisher)
        if publisher.text("type") == "opcua":
            yield from _certificate_files(facts, publisher)


def _endpoint(publisher: Item) -> tuple[str, int] | None:
    """Host and port on which a publisher listens; None when they cannot be told."""
    model = _DEFAULTS.get(publisher.text("type") or "")
    if model is None:
        return None
    values = []
    for key in ("host", "port"):
        node = below(publisher.block, key)
        values.append(model.model_fields[key].default if node is None else _value(node))
    host, port = values
    if not isinstance(host, str) or not isinstance(port, int) or isinstance(port, bool):
        return None
    return _LOCAL.get(host.lower(), host.lower()), port


def _value(node: Any) -> Any:
    return node.value if isinstance(node, Scalar) else None


def _same_place(one: tuple[str, int], other: tuple[str, int]) -> bool:
    hosts = one[0], other[0]
    return one[1] == other[1] and (hosts[0] == hosts[1] or any(host in _EVERYWHERE for host in hosts))


def _ports(facts: Facts) -> Iterator[Problem]:
    taken: list[tuple[Item, tuple[str, int]]] = []
    for publisher in facts.publishers:
        endpoint = _endpoint(publisher)
        if endpoint is None:
            continue
        where = at(below(publisher.block, "port"), publisher.block)
        path = (*publisher.path, "port")
        clash = next((other for other, used in taken if _same_place(used, endpoint)), None)
        if clash is not None:
            text = (
                f"port {endpoint[1]} on {shown(endpoint[0])} is taken by the publisher in line {clash.block.line}, "
                "expected another port"
            )
            yield Problem(*where, path, text)
        taken.append((publisher, endpoint))
    for source in facts.sources:
        yield from _own_server(source, taken)


def _own_server(source: Item, taken: list[tuple[Item, tuple[str, int]]]) -> Iterator[Problem]:
    """A source on this machine at the port of a publisher: one of the two is wrong."""
    key: tuple[str, ...] = ("url",) if source.text("type") == "opcua" else ("transport", "port")
    found = host_and_port(source.text("url") or "", 4840) if key == ("url",) else _modbus_device(source)
    if found is None:
        return
    device = _LOCAL.get(found[0].lower(), found[0].lower()), found[1]
    local = device[0].startswith("127.") or device[0] == "::1"
    for publisher, endpoint in taken:
        if endpoint == device or (local and _same_place(endpoint, device)):
            text = (
                f"port {device[1]} on {shown(device[0])} is where softplc itself serves "
                f"(publisher in line {publisher.block.line}), expected the port of a device"
            )
            yield Problem(*at(below(source.block, *key), source.block), (*source.path, *key), text)
            return


def _modbus_device(source: Item) -> tuple[str, int] | None:
    host, port = text_at(source.block, "transport", "host"), below(source.block, "transport", "port")
    number = 502 if port is None else _value(port)
    return (host, number) if host and isinstance(number, int) else None


def _places(facts: Facts, publisher: Item) -> Iterator[Problem]:
    """What the register map says to these tasks, sources and axes and to the places that axes are given."""
    if {"axes", "sources", "tasks"} & facts.unknown:
        return
    names = list(dict.fromkeys(axis.name or f"{number}" for number, axis in enumerate(facts.axes)))
    known = set(names)
    placed: list[tuple[str, int]] = []
    blocks = []
    for path, block in items_at(publisher.block, "placements"):
        axis, address = text_at(block, "axis"), _value(below(block, "address"))
        if axis is not None and axis in known and type(address) is int and address in range(0, REGISTERS, 2):
            placed.append((axis, address))
            blocks.append(((*publisher.path, *path), block))
    if len(placed) > AXES.most:
        text = f"found {len(placed)} placements, expected at most {AXES.most}, which fill the register map"
        yield Problem(
            *at(below(publisher.block, "placements"), publisher.block), (*publisher.path, "placements"), text
        )
        return
    tasks = {axis.text("task") or task_names(facts)[0] for axis in facts.axes}
    sources = {tag.source for tag in facts.tags}
    try:
        place(len(tasks), len(sources), names, placed)
    except PlacementError as error:
        for number, text in error.problems:
            path, block = (publisher.path, publisher.block) if number is None else blocks[number]
            node = below(block, "address")
            yield Problem(*at(node, block), (*path, "address") if node is not None else path, shown(text, LONG))


def _certificate_files(facts: Facts, publisher: Item) -> Iterator[Problem]:
    """What is wrong with the server's certificate and key; nothing where both are still to be made."""
    block = below(publisher.block, "security")
    texts = {key: text_at(block, key) for key in ("certificate", "private_key", "trusted", "rejected")}
    if any(texts[key] is None for key in ("certificate", "private_key", "trusted")):
        return
    from softplc.publishers.opcua.own_certificate import problems  # noqa: PLC0415  only where there is one

    try:
        security = OpcUaServerSecurity.model_validate(texts, context={"folder": facts.folder})
    except ValidationError:
        return  # told where the models are made
    for key, text in problems(security):
        path = (*publisher.path, "security", key)
        yield Problem(*at(below(block, key), publisher.block), path, shown(text, LONG))
