"""What `for` of a template says: a range, a list, names with either, or a table; as one row of names an instance."""

import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Final

from softplc.config.problem import Path, Problem
from softplc.config.table import read_table
from softplc.config.tree import Cell, Hole, Mapping, Node, Scalar, Sequence
from softplc.config.words import found

MOST_INSTANCES: Final = 100_000  # of one template
_RANGE: Final = re.compile(r"\s*(-?[0-9]{1,9})\s*\.\.\s*(-?[0-9]{1,9})(?:\s+step\s+([0-9]{1,9}))?\s*")
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
_EXPECTED: Final = "a range as in 1..100, a list, names with either, or a table as in tags.csv"
_ONE: Final = "a range as in 1..100, or a list"
NUMBER: Final = "n"  # the instance's number from 0, beside the names of the template's own

Cells = Callable[[], Iterator[Cell]]


@dataclass(slots=True)
class Loop:
    """The instances of a template. `file` names the table that they are from, "" for none."""

    names: frozenset[str]
    count: int
    rows: Callable[[], Iterator[dict[str, Cell]]]
    file: str = ""

    def instances(self) -> Iterator[tuple[str, dict[str, Cell]]]:
        """What each instance is called in a report, and what its names stand for."""
        for number, row in enumerate(self.rows()):
            if self.file:
                line = next(iter(row.values())).line
                said = f"line {line} of {self.file}"
            else:
                said = ", ".join([f"{name}={cell.text}" for name, cell in row.items()])
            yield said, {NUMBER: Cell(str(number), number), **row}


@dataclass(slots=True)
class _Said:
    path: Path
    problems: list[Problem] = field(default_factory=list)

    def wrong(self, node: Node, text: str, *below: str | int) -> None:
        self.problems.append(Problem(node.line, node.column, (*self.path, *below), text))


def read_loop(node: Node, path: Path, folder: FilePath) -> tuple[Loop | None, list[Problem]]:
    """The instances that a `for` asks for, or None and what is wrong with it."""
    said = _Said(path)
    if isinstance(node, Scalar) and isinstance(node.value, str) and node.value.casefold().endswith(".csv"):
        return _table(node, node.value, folder, said)
    if isinstance(node, Mapping):
        named = _names(node, said)
    else:
        one = _cells(node, said, _EXPECTED)
        named = {} if one is None else {"i": one}
    count = math.prod(length for length, _ in named.values())
    if count > MOST_INSTANCES:
        said.wrong(node, f"found {count} instances, expected at most {MOST_INSTANCES}")
    if said.problems or not named:
        return None, said.problems

    def rows() -> Iterator[dict[str, Cell]]:
        for cells in itertools.product(*(list(make()) for _, make in named.values())):
            yield dict(zip(named, cells, strict=True))

    return Loop(frozenset((*named, NUMBER)), count, rows), []


def _table(node: Scalar, name: str, folder: FilePath, said: _Said) -> tuple[Loop | None, list[Problem]]:
    path = folder / name
    table = read_table(path, str(path))
    problems = table.problems
    if not table.columns and len(problems) == 1 and (problems[0].line, problems[0].column) == (1, 1):
        said.wrong(node, f"{path}: {problems[0].text}")  # about the file as such
        return None, said.problems
    if len(table.rows) > MOST_INSTANCES:
        said.wrong(node, f"found {len(table.rows)} rows in {path}, expected at most {MOST_INSTANCES}")
        return None, said.problems
    problems = [Problem(each.line, each.column, said.path, each.text, each.file) for each in problems]
    if not table.rows:
        return None, problems
    return Loop(frozenset((*table.columns, NUMBER)), len(table.rows), lambda: iter(table.rows), str(path)), problems


def _names(node: Mapping, said: _Said) -> dict[str, tuple[int, Cells]]:
    named: dict[str, tuple[int, Cells]] = {}
    if not node.entries and not node.partial:
        said.wrong(node, f"found an empty block {{}}, expected {_EXPECTED}")
    for name, entry in node.entries.items():
        inner = _Said((*said.path, name), said.problems)
        if not _NAME.fullmatch(name):
            inner.problems.append(
                Problem(entry.line, entry.column, inner.path, "expected a name of letters, digits and _")
            )
            continue
        cells = _cells(entry.value, inner, _ONE)
        if cells is not None:
            named[name] = cells
    return {} if said.problems else named


def _cells(node: Node, said: _Said, expected: str) -> tuple[int, Cells] | None:
    """How many values a range or list has, and what makes them."""
    if isinstance(node, Hole):
        return None
    if isinstance(node, Sequence):
        items = [item for item in node.items if isinstance(item, Scalar) and item.value is not None]
        for number, item in enumerate(node.items):
            if item not in items and not isinstance(item, Hole):
                said.wrong(item, f"found {found(item)}, expected a text or a number", number)
        if not node.items and not node.partial:
            said.wrong(node, f"found an empty list, expected {expected}")
        cells = [Cell(item.text, item.value) for item in items]
        return (len(cells), lambda: iter(cells)) if cells else None
    match = _RANGE.fullmatch(node.value) if isinstance(node, Scalar) and isinstance(node.value, str) else None
    if match is None:
        said.wrong(node, f"found {found(node)}, expected {expected}")
        return None
    first, last, step = int(match[1]), int(match[2]), int(match[3] or 1)
    if first > last or step == 0:
        wanted = "a step of 1 or more" if step == 0 else "the lower number first"
        said.wrong(node, f"found {match[0].strip()}, expected {wanted}")
        return None
    numbers = range(first, last + 1, step)
    return len(numbers), lambda: (Cell(str(number), number) for number in numbers)
