"""Builds the tree out of a YAML parser's events, one after the other, and goes on after every error.

The stack is its own, so that depth costs no recursion. An alias shares the node that it refers to.
"""

from dataclasses import dataclass, field
from typing import Final

from softplc.config.problem import Path, Problem, shown
from softplc.config.scalars import resolve
from softplc.config.tree import Entry, Hole, Mapping, Node, Scalar, Sequence, joined

MOST_LEVELS: Final = 32
MOST_VALUES: Final = 300_000  # keys count, aliases are expanded; a thousand axes need about 30 000

_STANDARD: Final = "tag:yaml.org,2002:"
_KIND_OF_TAG: Final = dict.fromkeys(("str", "int", "float", "bool", "null"), "scalar") | {
    "map": "mapping",
    "seq": "sequence",
}


@dataclass(slots=True)
class _Frame:
    """A list or mapping that is still open; `key` is the key whose value comes next, `text` its text if it is one.

    `ignored`: it is (part of) a key, or the value of a key that is no text.
    """

    node: Mapping | Sequence
    path: Path
    anchor: str | None
    key: Entry | None = None
    text: str | None = None
    merges: list[Node] = field(default_factory=list)
    ignored: bool = False


class Composer:
    """Takes events by its methods and gives the tree by `finish`. Set `position` before each event."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.position = (1, 1)
        self._root: Node | None = None
        self._stack: list[_Frame] = []
        self._anchors: dict[str, Node | None] = {}  # None: still open
        self._values = 0
        self._full = False
        self._last: Node | None = None  # the last value
        self._closed: list[Mapping | Sequence] = []  # what ended since then

    @property
    def open_since(self) -> int:
        """Line where the innermost open list or mapping starts."""
        return self._stack[-1].node.line if self._stack else 1

    def say(self, text: str, path: Path | None = None) -> None:
        """Report something at the position."""
        self.problems.append(Problem(*self.position, self._path() if path is None else path, text))

    def finish(self, *, complete: bool) -> Node | None:
        """The tree. When the text was not read to its end, what is doubtful is marked as partial."""
        if not complete:
            self._doubt()
        while self._stack:
            self.close()
        return self._root

    def scalar(self, text: str, tag: str | None, anchor: str | None, *, quoted: bool) -> bool:
        """One value or key; False when nothing more is to be read."""
        self._closed.clear()
        line, column = self.position if text or quoted else self._nothing_at()
        node: Node = Hole(line, column)
        if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
            self.say("found half a character (\\ud800 … \\udfff), expected whole ones")
        elif tag is None or self._allowed(tag, "scalar"):
            as_text = quoted if tag is None else tag == f"{_STANDARD}str"
            node = Scalar(line, column, text if as_text else resolve(text), text, quoted)
        self._last = node
        self._add(node, anchor)
        return self._counted(1)

    def alias(self, name: str) -> None:
        """`*name`: the node of that anchor once more."""
        self._closed.clear()
        node = self._anchors.get(name)
        if name not in self._anchors:
            self.say(f"*{shown(name)} refers to nothing, expected an anchor &{shown(name)} further up")
        elif node is None:
            self.say(f"*{shown(name)} refers to the block that it stands in")
        elif len(self._stack) + node.height > MOST_LEVELS:
            self.say(f"*{shown(name)} makes more than {MOST_LEVELS} levels here")
            node = None
        elif not self._counted(node.size):
            node = None
        self._add(node or Hole(*self.position), None)

    def open(self, tag: str | None, anchor: str | None, *, mapping: bool) -> bool:
        """A list or mapping begins; False when nothing more is to be read."""
        self._closed.clear()
        if len(self._stack) >= MOST_LEVELS:
            self.say(f"more than {MOST_LEVELS} levels of lists and blocks, expected fewer")
            return False
        node = Mapping(*self.position) if mapping else Sequence(*self.position)
        frame = _Frame(node, self._path(), anchor)
        parent = self._stack[-1] if self._stack else None
        if parent is not None:
            in_mapping = isinstance(parent.node, Mapping)
            frame.ignored = parent.ignored or (in_mapping and parent.text is None)
            if in_mapping and parent.key is None and not parent.ignored:
                self.say("found a key that is not a text, expected key: value", parent.path)
        if tag is not None and not self._allowed(tag, "mapping" if mapping else "sequence"):
            frame.ignored = True
        if anchor is not None:
            self._anchors[anchor] = None
        self._stack.append(frame)
        return self._counted(1)

    def close(self) -> None:
        """The innermost list or mapping ends."""
        frame = self._stack.pop()
        node: Node = frame.node
        self._closed.append(frame.node)
        if isinstance(frame.node, Mapping):
            for base in frame.merges:
                self._merge(frame.node, base, frame.path)
        if frame.ignored:
            node = Hole(node.line, node.column, node.size, node.height)
        self._add(node, frame.anchor)

    def _path(self) -> Path:
        """Path of the value that comes next."""
        if not self._stack:
            return ()
        frame = self._stack[-1]
        if isinstance(frame.node, Sequence):
            return (*frame.path, len(frame.node.items))
        return frame.path if frame.text is None else (*frame.path, frame.text)

    def _nothing_at(self) -> tuple[int, int]:
        """Where to report a value that is not there: at its key, as the parser gives the place of what follows."""
        key = self._stack[-1].key if self._stack else None
        return (key.line, key.column) if key is not None else self.position

    def _counted(self, more: int) -> bool:
        """Whether there is room for more values; says so once when there is not."""
        room = self._values + more <= MOST_VALUES
        if room:
            self._values += more
        elif not self._full:
            self._full = True
            self.say(f"more than {MOST_VALUES} values (aliases expanded), expected a smaller file")
        return room

    def _allowed(self, tag: str, kind: str) -> bool:
        if tag == "!" or _KIND_OF_TAG.get(tag.removeprefix(_STANDARD)) == kind:
            return True
        self.say(f"found the YAML tag {shown(tag.replace(_STANDARD, '!!'))}, expected none here; remove it")
        return False

    def _add(self, node: Node, anchor: str | None) -> None:
        """Put a finished node where it belongs."""
        if anchor is not None:
            self._anchors[anchor] = node
        if not self._stack:
            self._root = node if self._root is None else self._root
            return
        frame = self._stack[-1]
        container = frame.node
        container.size += node.size
        container.height = max(container.height, node.height + 1)
        if isinstance(container, Sequence):
            container.items.append(node)
        elif frame.key is None:
            self._take_key(frame, node)
        else:
            self._take_value(frame, frame.key, container, node)

    def _take_key(self, frame: _Frame, node: Node) -> None:
        place = self.position if isinstance(node, Scalar) else (node.line, node.column)
        frame.key = Entry(*place, node)
        frame.text = node.text if isinstance(node, Scalar) else None
        if isinstance(node, Mapping | Sequence):  # an alias
            self.say("found a key that is not a text, expected key: value", frame.path)

    def _take_value(self, frame: _Frame, key: Entry, container: Mapping, node: Node) -> None:
        text, entries = frame.text, container.entries
        frame.key = frame.text = None
        if text is None:
            return
        if text == "<<" and isinstance(key.value, Scalar) and not key.value.quoted:
            frame.merges.append(node)
        elif text not in entries:
            entries[text] = Entry(key.line, key.column, node)
        elif not frame.ignored:
            first = entries[text]
            words = f"found the key {shown(text)} a second time (the first is in line {first.line}), expected it once"
            self.problems.append(Problem(key.line, key.column, (*frame.path, text), words))
            first.value = joined(first.value, node)

    def _merge(self, into: Mapping, base: Node, path: Path) -> None:
        """`<<: *base`: take the keys of the base that are not given here."""
        if isinstance(base, Mapping):
            for key, entry in base.entries.items():
                into.entries.setdefault(key, entry)
        elif isinstance(base, Sequence) and all(isinstance(item, Mapping | Hole) for item in base.items):
            for item in base.items:
                self._merge(into, item, path)
        elif not isinstance(base, Hole):
            text = "expected a block of keys, as in <<: *name"
            self.problems.append(Problem(base.line, base.column, (*path, "<<"), text))

    def _doubt(self) -> None:
        """Reading stopped: what is open or has just ended may go on; the last value may not be what was meant."""
        for ended in self._closed:
            ended.partial = True
        for frame in self._stack:
            frame.node.partial = True
        if not self._stack or self._last is None:
            return
        hole = Hole(self._last.line, self._last.column)
        container = self._stack[-1].node
        if isinstance(container, Mapping):
            for entry in container.entries.values():
                entry.value = hole if entry.value is self._last else entry.value
        elif container.items and container.items[-1] is self._last:
            container.items[-1] = hole
