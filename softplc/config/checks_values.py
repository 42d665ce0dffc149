"""Values that fit their keys but not each other: ranges, bleed, scales."""

from collections.abc import Iterator
from urllib.parse import urlsplit

from softplc.config import words
from softplc.config.checks_names import at
from softplc.config.facts import Facts, Item
from softplc.config.problem import Problem
from softplc.config.tree import Node, Scalar, Sequence, below


def check(facts: Facts) -> Iterator[Problem]:
    """All problems with values."""
    for axis in facts.axes:
        yield from _range(axis)
        yield from _bleed(axis)
    for tag in facts.tags:
        scale = below(tag.block, "scale")
        if scale is not None and number(scale) == 0:
            yield Problem(*at(scale, scale), (*tag.path, "scale"), "found 0, expected any other number")


def number(node: Node | None) -> float | None:
    """The number that a node holds, or None."""
    if not isinstance(node, Scalar) or isinstance(node.value, bool) or not isinstance(node.value, int | float):
        return None
    return node.value


def limits(axis: Item) -> tuple[float, float] | None:
    """Both numbers of an axis' range, or None."""
    pair = below(axis.block, "range")
    if not isinstance(pair, Sequence) or len(pair.items) != 2:
        return None
    low, high = number(pair.items[0]), number(pair.items[1])
    return None if low is None or high is None else (low, high)


def _range(axis: Item) -> Iterator[Problem]:
    pair = limits(axis)
    if pair is not None and pair[0] >= pair[1]:
        low, high = (words.figure(bound) for bound in pair)
        node = below(axis.block, "range")
        text = f"found {low} before {high}, expected the lowest position first and a higher one after it"
        yield Problem(*at(node, axis.block), (*axis.path, "range"), text)


def _bleed(axis: Item) -> Iterator[Problem]:
    """A threshold as wide as the range would damp the velocity of every sample."""
    node, pair = below(axis.block, "observer", "bleed", "threshold"), limits(axis)
    threshold = number(node)
    if node is None or threshold is None or pair is None or pair[0] >= pair[1] or threshold < pair[1] - pair[0]:
        return
    text = (
        f"found {words.figure(threshold)}, as wide as the axis' range, so that the velocity would bleed always, "
        "expected a deviation as near rest"
    )
    yield Problem(*at(node, node), (*axis.path, "observer", "bleed", "threshold"), text)


def host_and_port(url: str, default: int) -> tuple[str, int] | None:
    """Host and port of an address such as opc.tcp://host:4840, or None when it is none."""
    try:
        parts = urlsplit(url)
        port = default if parts.port is None else parts.port
    except ValueError:
        return None
    return (parts.hostname, port) if parts.hostname and port else None
