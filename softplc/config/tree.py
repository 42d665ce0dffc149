"""A YAML document as a tree in which every value and every key knows its line and column."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from softplc.config.problem import Path
from softplc.config.scalars import Value


@dataclass(slots=True)
class Scalar:
    """One value. `text` is as in the file, without quotes; `quoted` says whether it had some."""

    line: int
    column: int
    value: Value
    text: str
    quoted: bool = False
    size: int = 1
    height: int = 0


@dataclass(frozen=True, slots=True)
class Cell:
    """What one name of a template stands for in one instance, and where that is written; `file` "": nowhere."""

    text: str
    value: Value
    line: int = 0
    column: int = 0
    file: str = ""


@dataclass(slots=True)
class Made(Scalar):
    """A value that a template's placeholders made: `instance` says of which one, `cell` where a table has it."""

    instance: str = ""
    cell: Cell | None = None


@dataclass(slots=True)
class Hole:
    """A place whose value cannot be told because it is wrong in itself; that was reported, so nothing else is."""

    line: int
    column: int
    size: int = 1
    height: int = 0
    cell: Cell | None = None


@dataclass(slots=True)
class Entry:
    """Value of a key, and where the key stands."""

    line: int
    column: int
    value: "Node"


@dataclass(slots=True)
class Mapping:
    """Keys and values. `partial`: the document broke off inside, so keys may be missing."""

    line: int
    column: int
    entries: dict[str, Entry] = field(default_factory=dict)
    partial: bool = False
    size: int = 1
    height: int = 1


@dataclass(slots=True)
class Sequence:
    """A list."""

    line: int
    column: int
    items: list["Node"] = field(default_factory=list)
    partial: bool = False
    size: int = 1
    height: int = 1


Node = Scalar | Mapping | Sequence | Hole
"""`size` counts the values below with aliases expanded, `height` the levels."""


def plain(node: Node) -> Any:
    """The tree as dicts, lists and values; a hole becomes None."""
    if isinstance(node, Mapping):
        return {key: plain(entry.value) for key, entry in node.entries.items()}
    if isinstance(node, Sequence):
        return [plain(item) for item in node.items]
    return node.value if isinstance(node, Scalar) else None


def where(node: Node) -> str:
    """Where a value stands, in words: its line, with the instance of a template or in the table it is from."""
    if not isinstance(node, Made):
        return f"line {node.line}"
    if node.cell is not None:
        return f"line {node.cell.line} of {node.cell.file}"
    return f"line {node.line}, {node.instance}"


def below(node: Node | None, *path: str | int) -> Node | None:
    """The node at a path, or None."""
    for key in path:
        if isinstance(node, Mapping) and isinstance(key, str):
            entry = node.entries.get(key)
            node = entry.value if entry is not None else None
        elif isinstance(node, Sequence) and isinstance(key, int) and key < len(node.items):
            node = node.items[key]
        else:
            return None
    return node


def text_at(node: Node | None, *path: str | int) -> str | None:
    """The text at a path, or None when there is none or something else."""
    found = below(node, *path)
    return found.value if isinstance(found, Scalar) and isinstance(found.value, str) else None


def items_at(node: Node | None, *path: str | int) -> Iterator[tuple[Path, Node]]:
    """The entries of the list at a path, each with its own path; none when there is no list."""
    found = below(node, *path)
    if isinstance(found, Sequence):
        for number, item in enumerate(found.items):
            yield (*path, number), item


def joined(first: Node, second: Node) -> Node:
    """Both values of a key that is there twice, so that the second one's content is looked at as well."""
    if isinstance(first, Sequence) and isinstance(second, Sequence):
        return Sequence(first.line, first.column, [*first.items, *second.items], first.partial)
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return Mapping(first.line, first.column, {**second.entries, **first.entries}, first.partial)
    return first
