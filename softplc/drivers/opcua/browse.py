"""Lists the variables of an OPC-UA server, with node id, type and value, for a person who writes a configuration."""

import asyncio
import fnmatch
import itertools
import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from asyncua import ua

from softplc.clock import Clock, SystemClock
from softplc.drivers.opcua.binding import read_value
from softplc.drivers.opcua.config import OpcUaSecurity, OpcUaUser
from softplc.drivers.opcua.credentials import Credentials
from softplc.drivers.opcua.node import BrowsePathAddress, Namespace, NodeIdAddress
from softplc.drivers.opcua.session import Session, batches, within
from softplc.drivers.opcua.types import plain_node
from softplc.drivers.opcua.values import INTEGER_RANGES, flat, nanoseconds, status_of
from softplc.errors import LinkError
from softplc.sample import is_bad

BATCH: Final = 50

RX: Final = "# r_x is the variance of the measurement noise, in the tag's unit squared: put in what yours has."

_ATTRIBUTES: Final = (ua.AttributeIds.Value, ua.AttributeIds.DataType, ua.AttributeIds.UserAccessLevel)
_STRUCTURES: Final = frozenset({ua.VariantType.ExtensionObject, ua.VariantType.ByteString, ua.VariantType.Variant})


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable. `path` is its browse path, `node` its node id by namespace index and `node_by_uri` by URI.

    `data_type` is the type's name; `length` the number of elements of an array, None for a single value. `value` is
    None where there is none, and for structures; `status` is raw, `source_timestamp` ns UTC.
    """

    path: str
    node: str
    node_by_uri: str
    data_type: str
    length: int | None
    value: Any
    status: int
    source_timestamp: int | None
    readable: bool
    writable: bool
    is_number: bool
    """Can be the input of an axis: a number, not a Boolean."""


@dataclass(frozen=True, slots=True)
class Listing:
    """The variables in the order of the server; not `complete` when a bound ended the search."""

    variables: tuple[Variable, ...]
    complete: bool


@dataclass(frozen=True, slots=True)
class _Found:
    steps: tuple[tuple[int, str], ...]
    node: ua.NodeId

    @property
    def path(self) -> str:
        return str(BrowsePathAddress(((0, "Objects"), *self.steps)))


async def browse(
    url: str,
    *,
    only: str | None = None,
    user: OpcUaUser | None = None,
    security: OpcUaSecurity | None = None,
    server_nodes: bool = False,
    max_nodes: int = 20_000,
    max_depth: int = 24,
    page: int = 1000,
    timeout: float = 10.0,
    limit: float = 120.0,
    clock: Clock | None = None,
) -> Listing:
    """Every variable below Objects whose path or node id contains `only` (or matches it, with * and ?; case aside).

    Objects of namespace 0, which describe the server itself, are left out unless `server_nodes`. At most
    `max_nodes` nodes down to `max_depth` levels are looked at, `page` children of a node in one answer; a request may
    take `timeout` seconds, all of it `limit`. Raises LinkError, and ConfigError for a secret or certificate that is
    not there.
    """
    session = Session(url, Credentials.load(user, security), clock or SystemClock(), timeout, max(30.0, 3 * timeout))

    async def work() -> Listing:
        await session.open(timeout)
        found, complete = await _walk(session, server_nodes, max_nodes, max_depth, page)
        chosen = [
            variable
            for variable in found
            if only is None or _matches(variable.path, only) or _matches(variable.node.to_string(), only)
        ]
        return Listing(tuple(await _describe(session, chosen)), complete)

    try:
        return await within(limit, work(), f"cannot browse {session.url}")
    finally:
        session.close()


def yaml_block(url: str, variables: Iterable[Variable], source: str = "plc") -> str:
    """A configuration's `sources` and `axes`, ready to paste, for those of the variables that are readable numbers.

    Nodes are named by namespace URI, which stays when a server restarts and its namespace indices change.
    """
    lines = ["sources:", "  - type: opcua", f"    name: {source}", f"    url: {json.dumps(url)}", RX, "axes:"]
    numbers = [variable for variable in variables if variable.is_number and variable.readable]
    for variable, name in zip(numbers, _names(numbers), strict=True):
        node = json.dumps(variable.node_by_uri, ensure_ascii=False)
        element = "" if variable.length is None else ", index: 0"
        of = "" if variable.length is None else f"[0 … {variable.length - 1}]"
        lines += [
            f"  - name: {name}  # {_printable(variable.path)}, {variable.data_type}{of}",
            f"    input: {{source: {source}, node: {node}{element}}}",
            "    observer: {type: aoi, r_x: 1.0}",
        ]
    if not numbers:
        lines[-1] = "axes: []  # no readable number among the variables"
    return "\n".join(lines) + "\n"


async def _walk(
    session: Session, server_nodes: bool, max_nodes: int, max_depth: int, page: int
) -> tuple[list[_Found], bool]:
    """Breadth first, each node once, by its shortest path."""
    level = [_Found((), ua.NodeId(ua.ObjectIds.ObjectsFolder))]
    seen = {level[0].node}
    variables: list[_Found] = []
    for _ in range(max_depth):
        below: list[_Found] = []
        for some in batches(level, min(BATCH, session.limits.browse)):
            for parent, references in zip(some, await _references(session, some, page), strict=True):
                for reference in references:
                    node = plain_node(reference.NodeId)
                    if node is None or node in seen or (node.NamespaceIndex == 0 and not server_nodes):
                        continue
                    if len(seen) > max_nodes:
                        return variables, False
                    seen.add(node)
                    name = reference.BrowseName
                    found = _Found((*parent.steps, (name.NamespaceIndex, name.Name or "")), node)
                    below.append(found)
                    if reference.NodeClass == ua.NodeClass.Variable:
                        variables.append(found)
        level = below
        if not level:
            return variables, True
    return variables, False


async def _references(session: Session, parents: Sequence[_Found], page: int) -> list[list[ua.ReferenceDescription]]:
    """Objects and variables below each of these, properties apart; all of them, over continuation points."""
    results = await session.browse([_description(parent.node) for parent in parents], page)
    lists: list[list[ua.ReferenceDescription]] = []
    for result in results:
        references = list(result.References or ())
        while result.ContinuationPoint and not is_bad(int(result.StatusCode.value)):
            (result,) = await session.browse_next([result.ContinuationPoint])  # noqa: PLW2901
            references += result.References or ()
        properties = ua.NodeId(ua.ObjectIds.HasProperty)
        lists.append([reference for reference in references if reference.ReferenceTypeId != properties])
    return lists


def _description(node: ua.NodeId) -> ua.BrowseDescription:
    return ua.BrowseDescription(
        NodeId=node,
        BrowseDirection=ua.BrowseDirection.Forward,
        ReferenceTypeId=ua.NodeId(ua.ObjectIds.HierarchicalReferences),
        IncludeSubtypes=True,
        NodeClassMask=ua.NodeClass.Object | ua.NodeClass.Variable,
        ResultMask=ua.BrowseResultMask.ReferenceTypeId
        | ua.BrowseResultMask.NodeClass
        | ua.BrowseResultMask.BrowseName,
    )


async def _describe(session: Session, found: Sequence[_Found]) -> list[Variable]:
    variables: list[Variable] = []
    names: dict[ua.NodeId, str] = {}
    for some in batches(found, max(1, min(BATCH, session.limits.read) // len(_ATTRIBUTES))):
        try:
            attributes = await _read_attributes(session, some)
        except LinkError:
            if len(some) == 1:
                raise
            attributes = [(await _read_attributes(session, [one]))[0] for one in some]  # together they were too much
        types = {declared for _, declared, _ in attributes if declared is not None} - names.keys()
        names |= await _type_names(session, sorted(types))
        for one, (data, declared, access) in zip(some, attributes, strict=True):
            variables.append(_variable(session, one, data, names.get(declared, "") if declared else "", access))
        await asyncio.sleep(0)
    return variables


async def _read_attributes(
    session: Session, some: Sequence[_Found]
) -> list[tuple[ua.DataValue, ua.NodeId | None, int]]:
    values = await session.read([read_value(one.node, attribute) for one in some for attribute in _ATTRIBUTES])
    return [
        (data, _content(declared, ua.NodeId), _content(access, int) or 0)
        for data, declared, access in batches(values, len(_ATTRIBUTES))
    ]


async def _type_names(session: Session, types: Sequence[ua.NodeId]) -> dict[ua.NodeId, str]:
    values: list[ua.DataValue] = []
    for some in batches(types, min(BATCH, session.limits.read)):
        values += await session.read([read_value(node, ua.AttributeIds.BrowseName) for node in some])
    names = [_content(data, ua.QualifiedName) for data in values]
    return {node: node.to_string() if name is None else name.Name for node, name in zip(types, names, strict=True)}


def _variable(session: Session, found: _Found, data: ua.DataValue, type_name: str, access: int) -> Variable:
    variant = data.Value
    status = status_of(data)
    has_value = variant is not None and (variant.Value is not None or variant.is_array) and not is_bad(status)
    kind = variant.VariantType if has_value else ua.VariantType.__members__.get(type_name)
    shown = has_value and variant.VariantType not in _STRUCTURES
    uri: Namespace = found.node.NamespaceIndex
    if 0 < found.node.NamespaceIndex < len(session.namespaces):
        uri = session.namespaces[found.node.NamespaceIndex]
    return Variable(
        path=found.path,
        node=str(NodeIdAddress(found.node.NamespaceIndex, found.node.Identifier)),
        node_by_uri=str(NodeIdAddress(uri, found.node.Identifier)),
        data_type=type_name or (kind.name if kind is not None else "unknown"),
        length=len(flat(variant.Value)) if has_value and variant.is_array else None,
        value=variant.Value if shown else None,
        status=status,
        source_timestamp=nanoseconds(data.SourceTimestamp),
        readable=bool(access & 1),
        writable=bool(access & 2),
        is_number=kind in (*INTEGER_RANGES, ua.VariantType.Float, ua.VariantType.Double),
    )


def _content(data: ua.DataValue, expected: type) -> Any:
    value = data.Value.Value if data.Value is not None else None
    return value if isinstance(value, expected) else None


def _matches(path: str, only: str) -> bool:
    if "*" in only or "?" in only:
        return fnmatch.fnmatchcase(path.lower(), only.lower())
    return only.lower() in path.lower()


def _names(variables: Sequence[Variable]) -> list[str]:
    """Names for axes: as many of the path's last steps as make the name the only one of its kind, or a number."""
    steps = [[re.sub(r"^[0-9]+:", "", step) for step in variable.path.split("/")[2:]] for variable in variables]
    longest = max((len(own) for own in steps), default=0)
    counts = [Counter(_legal("_".join(own[-length:])) for own in steps) for length in range(1, longest + 1)]
    names: list[str] = []
    for own in steps:
        candidates = [(_legal("_".join(own[-length:])), counts[length - 1]) for length in range(1, len(own) + 1)]
        lonely = (name for name, count in candidates if count[name] == 1)
        numbered = (f"{candidates[-1][0][:58]}_{number}" for number in range(1, 100_000))
        names.append(next(name for name in itertools.chain(lonely, numbered) if name not in names))
    return names


def _legal(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", text)[-64:].strip("-") or "Axis"
    return name if re.match(r"[A-Za-z_]", name) else f"_{name}"[:64]


def _printable(text: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in text)
