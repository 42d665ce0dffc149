"""Write-backs onto something that softplc reads, for whichever axis: an observer would filter its own output."""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

from softplc.config.checks_names import at
from softplc.config.problem import Problem
from softplc.config.spans import Span, key_of
from softplc.config.tree import below
from softplc.drivers.opcua.node import BrowsePathAddress, NodeIdAddress

_RIGHT = "expected an address that softplc does not read"


def loops(spans: list[Span]) -> Iterator[Problem]:
    """Each write-back that closes a loop, or that closes one if an index and a URI name the same namespace."""
    reader: dict[Any, list[Span]] = defaultdict(list)
    for span in spans:
        if span.tag.role != "write_back":
            for place in span.places:
                reader[span.device, _loosely(span), place].append(span)
    for span in spans:
        if span.tag.role != "write_back":
            continue
        others = [other for place in span.places for other in reader[span.device, _loosely(span), place]]
        others = [other for other in others if _may_be_one(span, other)]
        same = next((other for other in others if _address(other) == _address(span)), None)
        alike = next(iter(others), None)
        if same is not None:
            text = f"{span.label} is also read ({same.tag}, {same.where}), which closes a loop, {_RIGHT}"
        elif alike is not None:
            text = (
                f"{span.label} may be {alike.label}, which is read ({alike.tag}, {alike.where}), and close a "
                f"loop: an index and a URI may mean one namespace, expected both spelled alike, or {_RIGHT[9:]}"
            )
        else:
            continue
        node = below(span.tag.block, key_of(span.tag))
        yield Problem(*at(node, span.tag.block), (*span.tag.path, key_of(span.tag)), text)


def _address(span: Span) -> Any:
    """The table of registers, or the node without the array index."""
    return span.table[0] if isinstance(span.table, tuple) else span.table


def _loosely(span: Span) -> Any:
    """What two spellings of one variable have in common: everything but namespaces and array index."""
    address = _address(span)
    if isinstance(address, NodeIdAddress):
        return "node id", type(address.identifier), address.identifier
    if isinstance(address, BrowsePathAddress):
        return "path", tuple(name for _, name in address.steps)
    return address


def _may_be_one(span: Span, other: Span) -> bool:
    """Equal but for namespaces of which one is an index and the other a URI; an array holds all of its elements."""
    if not isinstance(span.table, tuple):
        return True
    (one, index), (two, second) = span.table, other.table
    if index != second and index is not None and second is not None:
        return False
    return all(
        first == last or (type(first) is not type(last) and 0 not in (first, last))
        for first, last in zip(_namespaces(one), _namespaces(two), strict=True)
    )


def _namespaces(address: NodeIdAddress | BrowsePathAddress) -> list[int | str]:
    if isinstance(address, NodeIdAddress):
        return [address.namespace]
    return [namespace for namespace, _ in address.steps]
