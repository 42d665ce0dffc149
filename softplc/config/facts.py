"""What the cross checks look at, taken from the tree: it is there even where the rest of a block is wrong."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Final

from softplc.config.problem import Path
from softplc.config.tree import Mapping, Node, Sequence, below, items_at, text_at

KIND_OF_KEY: Final = {"node": "opcua", "address": "modbus", "column": "replay"}
KEY_OF_KIND: Final = {kind: key for key, kind in KIND_OF_KEY.items()}


@dataclass(frozen=True, slots=True)
class Item:
    """One entry of a list; `name` is None when it has none that can be read."""

    path: Path
    block: Mapping
    name: str | None

    def text(self, *path: str | int) -> str | None:
        """The text below the entry, or None."""
        return text_at(self.block, *path)


@dataclass(frozen=True, slots=True)
class TagUse:
    """A tag of a source where it stands: `role` is input, enable, contact, shadow, write_back or heartbeat.

    `axis` is the axis that has it, of a heartbeat its source.
    """

    role: str
    axis: Item
    path: Path
    block: Mapping
    source: str | None

    @property
    def kind(self) -> str | None:
        """The protocol whose key it has: opcua, modbus or replay."""
        return next((kind for key, kind in KIND_OF_KEY.items() if key in self.block.entries), None)

    def __str__(self) -> str:
        name = self.axis.name or f"axes[{self.axis.path[-1]}]"
        return f"{self.role} of {name}"


@dataclass(slots=True)
class Facts:
    """The lists of a configuration; in `unknown` those that are missing, wrong, or broken off by a syntax error."""

    root: Node
    folder: FilePath = FilePath()  # of the file
    tasks: list[Item] = field(default_factory=list)
    sources: list[Item] = field(default_factory=list)
    axes: list[Item] = field(default_factory=list)
    publishers: list[Item] = field(default_factory=list)
    tags: list[TagUse] = field(default_factory=list)
    unknown: set[str] = field(default_factory=set)
    source_named: dict[str, Item] = field(default_factory=dict)
    kinds_named: dict[str, set[str | None]] = field(default_factory=dict)

    def source_of(self, tag: TagUse) -> Item | None:
        """The source that a tag names, the first of that name."""
        return self.source_named.get(tag.source) if tag.source is not None else None


def gather(root: Node, folder: FilePath) -> Facts:
    """The facts of a tree, of a file in this folder."""
    facts = Facts(root, folder)
    for key in ("tasks", "sources", "axes", "publishers"):
        found = below(root, key)
        getattr(facts, key).extend(_items(root, key))
        optional = key in ("tasks", "publishers") and found is None and not _partial(root)
        if not optional and (not isinstance(found, Sequence) or found.partial):
            facts.unknown.add(key)
    for source in facts.sources:
        if source.name is not None:
            facts.source_named.setdefault(source.name, source)
            facts.kinds_named.setdefault(source.name, set()).add(source.text("type"))
    for axis in facts.axes:
        facts.tags.extend(_tags(axis))
    for source in facts.sources:
        beat = below(source.block, "heartbeat")
        if isinstance(beat, Mapping):
            facts.tags.append(TagUse("heartbeat", source, (*source.path, "heartbeat"), beat, source.name))
    return facts


def _partial(root: Node) -> bool:
    return isinstance(root, Mapping) and root.partial


def _items(root: Node, key: str) -> Iterator[Item]:
    for path, block in items_at(root, key):
        if isinstance(block, Mapping):
            yield Item(path, block, text_at(block, "name"))


def _tags(axis: Item) -> Iterator[TagUse]:
    places: list[tuple[str, Path]] = [(role, (role,)) for role in ("input", "enable", "contact")]
    places += [("shadow", ("shadow", part)) for part in ("position", "velocity", "dt")]
    places += [("write_back", (*path, "tag")) for path, _ in items_at(axis.block, "write_back")]
    for role, path in places:
        block = below(axis.block, *path)
        if isinstance(block, Mapping) and "writable" not in block.entries:
            yield TagUse(role, axis, (*axis.path, *path), block, text_at(block, "source"))
