"""Templates: an entry of a list that says `for` becomes as many entries as that asks for.

```yaml
axes:
  - for: 1..10000
    name: Axis{i:05}
    input: { source: plc, address: "holding:{2*i}" }
```

What has no placeholder is the same node in every instance, so that ten thousand of them cost little. The tree has
the instances; a report speaks of the template: `Expansion.located` takes problems back to it.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any, Final

from softplc.config.loops import Loop, read_loop
from softplc.config.place import SECRET_KEY
from softplc.config.placeholders import Pattern, PlaceholderError, read
from softplc.config.problem import Path, Problem
from softplc.config.schema_templates import FOR, LISTS
from softplc.config.tree import Cell, Entry, Hole, Made, Mapping, Node, Scalar, Sequence, below

_FIGURES: Final = re.compile("[0-9]+")
MOST_MADE: Final = 2_000_000  # values of all instances, those that they share counted in each


@dataclass(slots=True)
class Template:
    """One entry of the file with its instances: `position` in the file's list, and how many."""

    position: int
    count: int


Origin = tuple[int, Template | None, str]
"""Of an entry of a list: its position in the file's list, its template, and what the instance is called."""


@dataclass(slots=True)
class Plan:
    """What of a node is to be made for each instance: its text, or some of its parts."""

    node: Node
    pattern: Pattern | None = None
    parts: "dict[str | int, Plan]" = field(default_factory=dict)
    bad: bool = False


@dataclass(slots=True)
class Expansion:
    """The lists that have templates, by path: for every entry of the list that was made, where it comes from.

    `problems` are those of the templates themselves, `unfilled` those of instances, with paths of the tree;
    `left_out` are the keys that an empty cell left out.
    """

    folder: FilePath
    lists: dict[Path, list[Origin]] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    unfilled: list[Problem] = field(default_factory=list)
    left_out: dict[Path, Cell] = field(default_factory=dict)
    made: int = 0

    def cell(self, path: Path, node: Node | None) -> Cell | None:
        """The cell of a table that a value is from, or that left its key out; None for none."""
        return node.cell if isinstance(node, Made | Hole) else self.left_out.get(path)

    def origin(self, path: Path) -> tuple[Path, Template | None, str]:
        """A path in the tree as one in the file, with the template and the instance that it lies in."""
        for length in (2, 4):
            entries = self.lists.get(path[: length - 1])
            number = path[length - 1] if len(path) >= length else None
            if entries is not None and isinstance(number, int) and number < len(entries):
                position, template, said = entries[number]
                return (*path[: length - 1], position, *path[length:]), template, said
        return path, None, ""

    def located(self, root: Node, problems: Iterable[Problem]) -> list[Problem]:
        """Problems with paths of the tree as problems of the file.

        One of a template stands there once, with the first instance that has it; one of a value from a table stands
        in the table, unless all rows have it.
        """
        found = list(self.problems)
        alike: dict[Any, list[tuple[Problem, Cell | None, Template, str]]] = defaultdict(list)
        for problem in (*self.unfilled, *problems):
            path, template, said = self.origin(problem.path)
            moved = Problem(problem.line, problem.column, path, problem.text)
            if template is None:
                found.append(moved)
                continue
            cell = self.cell(problem.path, below(root, *problem.path))
            kind = _kind(problem.text) if cell is None else ""
            alike[id(template), moved.line, moved.column, path, kind].append((moved, cell, template, said))
        for each in alike.values():
            found += _of_template(each)
        return found


def _kind(text: str) -> str:
    """What is alike in the same problem of several instances: what is wanted, or else what there is not."""
    found, _, wanted = text.partition(", expected")
    return _FIGURES.sub("", wanted if text.startswith("found") and wanted else found.partition("; did you mean")[0])


def _of_template(alike: list[tuple[Problem, Cell | None, Template, str]]) -> Iterator[Problem]:
    first, cell, template, said = alike[0]
    if cell is None or len({said for _, _, _, said in alike}) == template.count > 1:
        text = f"{first.text} (first in {said})" if template.count > 1 else first.text
        yield Problem(first.line, first.column, first.path, text)
        return
    for problem, cell, _, _ in alike:
        if cell is not None:
            text = f"{problem.text} (template in line {problem.line})"
            yield Problem(cell.line, cell.column, problem.path, text, cell.file)


def expand(root: Node, folder: FilePath) -> Expansion:
    """Replace the templates of a tree by their instances; a template that cannot be read leaves its list partial."""
    expansion = Expansion(folder)
    for path, sequence in _lists(root):
        if any(isinstance(item, Mapping) and FOR in item.entries for item in sequence.items):
            _expand_list(expansion, path, sequence)
    return expansion


def _lists(root: Node) -> Iterator[tuple[Path, Sequence]]:
    if not isinstance(root, Mapping):
        return
    for top, *rest in LISTS:
        entry = root.entries.get(top)
        if entry is None or not isinstance(entry.value, Sequence):
            continue
        if not rest:
            yield (top,), entry.value
            continue
        for number, item in enumerate(entry.value.items):
            inner = item.entries.get(rest[0]) if isinstance(item, Mapping) else None
            if inner is not None and isinstance(inner.value, Sequence):
                yield (top, number, rest[0]), inner.value


def _expand_list(expansion: Expansion, path: Path, sequence: Sequence) -> None:
    items: list[Node] = []
    origins: list[Origin] = []
    for position, item in enumerate(sequence.items):
        if not isinstance(item, Mapping) or FOR not in item.entries:
            items.append(item)
            origins.append((position, None, ""))
            continue
        loop, problems = read_loop(item.entries[FOR].value, (*path, position, FOR), expansion.folder)
        expansion.problems += problems
        sequence.partial = sequence.partial or bool(problems)
        if loop is None:
            sequence.partial = True
            continue
        expansion.made += item.size * loop.count
        if expansion.made > MOST_MADE:
            text = f"more than {MOST_MADE} values in all instances, expected fewer instances"
            expansion.problems.append(Problem(item.line, item.column, (*path, position, FOR), text))
            sequence.partial = True
            break
        template = Template(position, loop.count)
        for said, made in _instances(expansion, item, (*path, position), (path, len(items)), loop):
            items.append(made)
            origins.append((position, template, said))
    sequence.items[:] = items
    sequence.size = 1 + sum(item.size for item in items)
    expansion.lists[path] = origins


def _instances(
    expansion: Expansion, item: Mapping, path: Path, first: tuple[Path, int], loop: Loop
) -> Iterator[tuple[str, Node]]:
    """Every instance, the first of which has the path `first` in the list that is made."""
    base = Mapping(item.line, item.column, {k: v for k, v in item.entries.items() if k != FOR}, item.partial)
    base.size, base.height = item.size, item.height
    plan = _plan(expansion, base, path, loop) or Plan(base)
    for number, (said, row) in enumerate(loop.instances()):
        made = _make(expansion, plan, (*first[0], first[1] + number), row, said)
        yield said, base if made is None else made


def _plan(expansion: Expansion, node: Node, path: Path, loop: Loop) -> Plan | None:
    """What of a node has placeholders; None for nothing."""
    if isinstance(node, Scalar):
        if not isinstance(node.value, str):
            return None
        try:
            pattern = read(node.value, loop.names, quoted=node.quoted)
        except PlaceholderError as error:
            expansion.problems.append(Problem(node.line, node.column, path, _said(error, path)))
            return Plan(node, bad=True)
        return None if pattern is None else Plan(node, pattern)
    inner: Iterator[tuple[str | int, Node]]
    if isinstance(node, Mapping):
        inner = ((key, entry.value) for key, entry in node.entries.items())
    else:
        inner = enumerate(node.items) if isinstance(node, Sequence) else iter(())
    parts = {key: plan for key, value in inner if (plan := _plan(expansion, value, (*path, key), loop)) is not None}
    return Plan(node, parts=parts) if parts else None


def _make(expansion: Expansion, plan: Plan, path: Path, row: dict[str, Cell], said: str) -> Node | None:
    """The node for one instance; None where an empty cell leaves it out."""
    node = plan.node
    if plan.bad:
        return Hole(node.line, node.column)
    if plan.pattern is not None:
        return _fill(expansion, plan.pattern, node, path, row, said)
    if isinstance(node, Mapping):
        entries = dict(node.entries)
        for key, part in plan.parts.items():
            entry = entries[str(key)]
            made = _make(expansion, part, (*path, key), row, said)
            if made is None:
                del entries[str(key)]
            else:
                entries[str(key)] = Entry(entry.line, entry.column, made)
        return Mapping(node.line, node.column, entries, node.partial, node.size, node.height)
    if isinstance(node, Sequence):
        items = list(node.items)
        for number, part in plan.parts.items():
            place = int(number)
            empty = Scalar(part.node.line, part.node.column, None, "")
            items[place] = _make(expansion, part, (*path, place), row, said) or empty
        return Sequence(node.line, node.column, items, node.partial, node.size, node.height)
    return node


def _fill(
    expansion: Expansion, pattern: Pattern, node: Node, path: Path, row: dict[str, Cell], said: str
) -> Node | None:
    cell = next((row[name] for name in pattern.names if row[name].file), None)
    try:
        value, text = pattern.fill(row)
    except PlaceholderError as error:
        expansion.unfilled.append(Problem(node.line, node.column, path, _said(error, path)))
        return Hole(node.line, node.column, cell=cell)
    if value is None and len(pattern.parts) == 1:
        if cell is not None:
            expansion.left_out[path] = cell
        return None
    return Made(node.line, node.column, value, text, False, 1, 0, said, cell)


def _said(error: PlaceholderError, path: Path) -> str:
    """What is wrong with a placeholder, without it where a secret may stand."""
    secret = any(isinstance(key, str) and SECRET_KEY.search(key) for key in path)
    return "found a placeholder that is not shown here and cannot be filled" if secret else str(error)
