"""Tags bound to a server's variables: addresses resolved, existence and type checked, trouble told in words.

Nothing here fails because of one tag: a tag that cannot be bound has a Bad status and a text that says what was
found and what would be right; it is tried again, for a server may come up before its PLC program does.
"""

import difflib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from asyncua import ua

from softplc.drivers.opcua.config import OpcUaTag
from softplc.drivers.opcua.node import (
    Address,
    BrowsePathAddress,
    Namespace,
    NodeIdAddress,
    parse_address,
    step_text,
)
from softplc.drivers.opcua.session import Session, batches
from softplc.drivers.opcua.types import FirstTypes, base_type, plain_node, same_kind
from softplc.drivers.opcua.values import NUMBER_TYPES, decode, flat, status_of
from softplc.sample import StatusCode, is_bad
from softplc.tags import Image

BATCH: Final = 100
"""Operations in one request while binding: the scan of others goes on between two requests."""
HINTS: Final = 5
"""Browse paths in one round that are searched for where they end, to tell what would be right."""

_MISSING: Final = frozenset({int(StatusCode.BAD_NODE_ID_UNKNOWN), ua.StatusCodes.BadNodeIdInvalid})
_NO_VARIABLE: Final = ua.StatusCodes.BadAttributeIdInvalid
_UNREADABLE: Final = frozenset({int(StatusCode.BAD_NOT_READABLE), ua.StatusCodes.BadUserAccessDenied})
_UNBOUND: Final = frozenset({*_MISSING, *_UNREADABLE, _NO_VARIABLE})
_LOST: Final = frozenset({*_UNBOUND, int(StatusCode.BAD_TYPE_MISMATCH)})


@dataclass
class Binding:
    """One variable and the tags that use it: `uses` are (position, array index or None).

    `node` is None until the address is resolved. `problem` is empty when all is well; `status` is Good, or why there
    is no value. `variant_type` is the type of the variable's elements as last seen; `first_types` is where the type
    that it had first is kept, None where any number will do. `handle` is its number
    among its group. `monitored`: a subscription reports it; `polled`: one did not when it should have, so it is read.
    """

    address: Address
    uses: list[tuple[int, int | None]]
    node: ua.NodeId | None = None
    status: int = StatusCode.BAD_NODE_ID_UNKNOWN
    problem: str = "not looked for yet"
    variant_type: ua.VariantType | None = None
    handle: int = 0
    monitored: bool = False
    polled: bool = False
    first_types: FirstTypes | None = None

    @property
    def trouble(self) -> str:
        """What is to be told of the tag; empty when all is well."""
        if self.polled and not self.problem:
            return f"{self.address}: the subscription fell silent about it; it is read in every scan instead"
        return self.problem

    def accepts(self, now: ua.VariantType) -> bool:
        """Whether a number of this type is still what the variable was; if not, its problem says so."""
        if self.first_types is None or now not in NUMBER_TYPES:
            return True
        first = self.first_types.setdefault(self.address, now)
        if first is now or same_kind(first, now):
            return True
        what = f"is {now.name} now and was {first.name}"
        cure = f"expected {first.name} again, or a new start of softplc that takes it as it is"
        self.lose(StatusCode.BAD_TYPE_MISMATCH, f"{self.address}: {what}; {cure}")
        return False

    def lose(self, status: int, problem: str) -> None:
        """From here on the tag has this Bad status, for this reason."""
        self.status, self.problem = status, problem

    def note(self, status: int) -> None:
        """Take notice of a status that came with a value: a node that vanished is looked for again."""
        if status in _LOST and not self.problem:
            self.lose(status, explain(status, self.address))
            self.monitored = False


def group(tags: Sequence[OpcUaTag], first_types: FirstTypes | None = None) -> list[Binding]:
    """One binding for each distinct node of the tags, so that an array is read once for all its elements."""
    bindings: dict[Address, Binding] = {}
    for position, tag in enumerate(tags):
        address = parse_address(tag.node)
        binding = bindings.setdefault(address, Binding(address, [], first_types=first_types, handle=len(bindings)))
        binding.uses.append((position, tag.index))
    return list(bindings.values())


async def bind(session: Session, bindings: Sequence[Binding]) -> None:
    """Resolve and check these bindings. Raises LinkError when the server does not answer."""
    await _resolve(session, bindings)
    for some in batches(
        [binding for binding in bindings if binding.node is not None], min(BATCH, session.limits.read)
    ):
        values = await session.read([read_value(binding.node) for binding in some])
        for binding, data in zip(some, values, strict=True):
            _check(binding, data)
    untyped = [b for b in bindings if b.node is not None and b.variant_type is None and b.status not in _UNBOUND]
    await _declared_types(session, untyped)


def read_value(node: ua.NodeId | None, attribute: ua.AttributeIds = ua.AttributeIds.Value) -> ua.ReadValueId:
    """What to read: the value of a node, or another attribute."""
    return ua.ReadValueId(NodeId=node, AttributeId=attribute)


def server_time() -> Binding:
    """What is read where there is no tag to read: the server has to prove that it lives."""
    address = NodeIdAddress(0, int(ua.ObjectIds.Server_ServerStatus_CurrentTime))
    return Binding(address, [], ua.NodeId(address.identifier), StatusCode.GOOD, "")


def put(binding: Binding, data: ua.DataValue, into: Image, arrival: float, now: int) -> None:
    """The samples of a variable's tags; `arrival` in monotonic seconds, `now` in ns UTC where it has no timestamp."""
    accepted = data.Value is None or is_bad(status_of(data)) or binding.accepts(data.Value.VariantType)
    for position, index in binding.uses:
        value, status, stamp = decode(data, index)
        if not accepted:
            value, status = math.nan, int(StatusCode.BAD_TYPE_MISMATCH)
        into.values[position] = value
        into.statuses[position] = status
        into.source_timestamps[position] = now if stamp is None else stamp
        into.arrivals[position] = arrival
    binding.note(status_of(data))


def explain(status: int, address: Address) -> str:
    """In words, why a variable gives no value."""
    if status in _MISSING:
        return f"{address}: the server has no such node; `softplc browse` lists what it has"
    if status == _NO_VARIABLE:
        return f"{address}: is not a variable; expected one, as a rule a child of this node"
    if status in _UNREADABLE:
        return f"{address}: may not be read by this user; expected read access at the server"
    return f"{address}: {ua.StatusCode(status).name}"


def _check(binding: Binding, data: ua.DataValue) -> None:
    """Judge a binding by the value that its node has now; a Bad value of an existing variable is not a problem."""
    status = status_of(data)
    if status in _UNBOUND:
        binding.lose(status, explain(status, binding.address))
        return
    binding.status, binding.problem = StatusCode.GOOD, ""
    variant = data.Value
    if is_bad(status) or variant is None or (variant.Value is None and not variant.is_array):
        return
    binding.variant_type = variant.VariantType
    if variant.VariantType not in NUMBER_TYPES:
        _no_number(binding)
        return
    if not binding.accepts(variant.VariantType):
        return
    wrong = [text for _, index in binding.uses if (text := _misuse(variant, index))]
    if wrong:  # each value's own status says the same
        binding.problem = f"{binding.address}: {'; '.join(wrong)}"


def _no_number(binding: Binding) -> None:
    what = "of no known type" if binding.variant_type is None else binding.variant_type.name
    binding.lose(StatusCode.BAD_TYPE_MISMATCH, f"{binding.address}: is {what}; expected a number or Boolean")


def _misuse(variant: ua.Variant, index: int | None) -> str:
    what = variant.VariantType.name
    if not variant.is_array:
        return "" if index is None else f"is a single {what}; expected no `index:`"
    last = len(flat(variant.Value)) - 1
    if index is None:
        return f"is an array of {last + 1} {what}; expected `index:` with the element, 0 … {last}"
    return f"index {index} is outside 0 … {last}" if index > last else ""


async def _resolve(session: Session, bindings: Iterable[Binding]) -> None:
    """Node ids of the addresses, as they are now; until the server answers, a binding keeps the node that it has."""
    paths: list[tuple[Binding, list[tuple[int, str]]]] = []
    for binding in bindings:
        address = binding.address
        try:
            if isinstance(address, NodeIdAddress):
                binding.node = ua.NodeId(address.identifier, _index(session, address.namespace))
            else:
                paths.append((binding, [(_index(session, namespace), name) for namespace, name in address.steps]))
        except LookupError as error:
            binding.node = None
            binding.lose(StatusCode.BAD_NODE_ID_UNKNOWN, f"{address}: {error.args[0]}")
    hints = HINTS
    for some in batches(paths, min(BATCH, session.limits.translate)):
        results = await session.translate([_browse_path(steps) for _, steps in some])
        for (binding, steps), result in zip(some, results, strict=True):
            targets = _targets(result)
            binding.node = targets[0] if len(targets) == 1 else None
            if len(targets) > 1:
                found = ", ".join(target.to_string() for target in targets)
                text = (
                    f"{binding.address}: leads to several nodes, {found}; expected a node id or an unambiguous path"
                )
                binding.lose(StatusCode.BAD_CONFIGURATION_ERROR, text)
            elif not targets:
                text = explain(StatusCode.BAD_NODE_ID_UNKNOWN, binding.address)
                if hints:
                    hints -= 1
                    text = await _hint(session, binding.address, steps) or text
                binding.lose(StatusCode.BAD_NODE_ID_UNKNOWN, text)


def _index(session: Session, namespace: Namespace) -> int:
    """Index of a namespace at this server, now. Raises LookupError in words."""
    known = ", ".join(f"{index} {uri}" for index, uri in enumerate(session.namespaces))
    if isinstance(namespace, str):
        if namespace not in session.namespaces:
            raise LookupError(f"the server has no namespace {namespace}; it has {known}")
        return session.namespaces.index(namespace)
    if namespace >= len(session.namespaces):
        raise LookupError(f"the server has no namespace {namespace}; it has {known}")
    return namespace


def _browse_path(steps: Sequence[tuple[int, str]]) -> ua.BrowsePath:
    elements = [
        ua.RelativePathElement(
            ReferenceTypeId=ua.NodeId(ua.ObjectIds.HierarchicalReferences),
            IsInverse=False,
            IncludeSubtypes=True,
            TargetName=ua.QualifiedName(name, index),
        )
        for index, name in steps
    ]
    return ua.BrowsePath(ua.NodeId(ua.ObjectIds.RootFolder), ua.RelativePath(elements))


def _targets(result: ua.BrowsePathResult) -> list[ua.NodeId]:
    """The nodes at the end of a path, each once; one that two references lead to is no ambiguity."""
    if is_bad(int(result.StatusCode.value)):
        return []
    ends = [target.TargetId for target in result.Targets or () if target.RemainingPathIndex == 0xFFFFFFFF]
    nodes = [plain_node(end) for end in ends]
    return [node for node in dict.fromkeys(nodes) if node is not None]


async def _hint(session: Session, address: Address, steps: list[tuple[int, str]]) -> str:
    """Where a browse path ends, and what there is instead; empty when the server does not tell."""
    assert isinstance(address, BrowsePathAddress)
    prefixes = [steps[: length + 1] for length in range(len(steps) - 1)][: session.limits.translate]
    found = [_targets(result) for result in await session.translate([_browse_path(prefix) for prefix in prefixes])]
    depth = sum(1 for targets in found if targets)
    if not depth or not found[depth - 1]:
        return ""
    wanted = step_text(*address.steps[depth])
    parent = BrowsePathAddress(address.steps[:depth])
    description = ua.BrowseDescription(
        NodeId=found[depth - 1][0],
        BrowseDirection=ua.BrowseDirection.Forward,
        ReferenceTypeId=ua.NodeId(ua.ObjectIds.HierarchicalReferences),
        IncludeSubtypes=True,
        ResultMask=ua.BrowseResultMask.BrowseName,
    )
    (result,) = await session.browse([description], 200)
    names = [step_text(ref.BrowseName.NamespaceIndex, ref.BrowseName.Name) for ref in result.References or ()]
    near = difflib.get_close_matches(wanted, names, 3, 0.5) or names[:5]
    there = f"there is {', '.join(near)}" if near else "nothing is under it"
    return f"{address}: under {parent} there is no {wanted}; {there}"


async def _declared_types(session: Session, bindings: Sequence[Binding]) -> None:
    """Types of variables that have no value yet, from their DataType and its supertypes."""
    pending = [(binding, binding.node) for binding in bindings]
    for some in batches(pending, min(BATCH, session.limits.read)):
        values = await session.read([read_value(node, ua.AttributeIds.DataType) for _, node in some])
        for (binding, _), data in zip(some, values, strict=True):
            declared = data.Value.Value if data.Value is not None else None
            if isinstance(declared, ua.NodeId):
                binding.variant_type = await base_type(session, declared)
            if binding.variant_type is not None and binding.variant_type not in NUMBER_TYPES:
                _no_number(binding)
