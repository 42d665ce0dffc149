"""A CSV table of which every cell knows its line and column: the first line names the columns.

Separated by commas, semicolons or tabs, whichever the first line has most of; cells in double quotes may hold
separators, and `""` for a quote. Blanks around a cell do not count, nor do lines that begin with #, empty
ones, and those that have nothing but empty cells, as spreadsheets leave them below the last row.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from softplc.config.problem import Problem, shown
from softplc.config.scalars import resolve
from softplc.config.source_text import read_text
from softplc.config.tree import Cell

_BREAK: Final = re.compile("\r\n|\n|\r")
_MOST_COLUMNS: Final = 200
Field = tuple[str, int]  # text, and column from 1


@dataclass(slots=True)
class Table:
    """Names of the columns, and for each row its cells by name."""

    columns: tuple[str, ...] = ()
    rows: list[dict[str, Cell]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


class _UnclosedError(ValueError):
    def __init__(self, column: int) -> None:
        super().__init__()
        self.column = column


def read_table(path: Path, name: str) -> Table:
    """The table in a file; `name` is what problems call it. A problem without a table is about the whole file."""
    text, problems = read_text(path, "CSV")
    table = Table(problems=[Problem(each.line, each.column, (), each.text, name) for each in problems])
    if text is None:
        return table
    lines = _lines(text)
    first = next(lines, None)
    if first is None:
        table.problems.append(Problem(1, 1, (), "the table is empty, expected the names of its columns", name))
        return table
    separator = max(",;\t", key=first[1].count)
    head = _fields(table, *first, separator, name)
    for number, (text, column) in enumerate(head):
        if not text or text in dict(head[:number]) or number >= _MOST_COLUMNS:
            found = f"a second column {shown(text)}" if text else "a column without a name"
            table.problems.append(Problem(first[0], column, (), f"found {found}, expected a name of its own", name))
            return table
    if not head:
        return table
    table.columns = tuple(text for text, _ in head)
    for number, line in lines:
        row = _fields(table, number, line, separator, name)
        if not any(text for text, _ in row):
            continue
        if len(row) != len(head):
            cells = f"{len(row)} cell{'s' * (len(row) != 1)}, expected {len(head)}, one for each column"
            table.problems.append(Problem(number, 1, (), f"found {cells}", name))
            continue
        cells_of = zip(table.columns, row, strict=True)
        table.rows.append({key: Cell(text, resolve(text), number, column, name) for key, (text, column) in cells_of})
    if not table.rows and not table.problems:
        table.problems.append(Problem(first[0], 1, (), "found no row below the names of the columns", name))
    return table


def _lines(text: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(_BREAK.split(text), 1):
        if line.strip() and not line.startswith("#"):
            yield number, line


def _fields(table: Table, number: int, line: str, separator: str, name: str) -> list[Field]:
    """The fields of a line; none, and a problem, when it cannot be read."""
    try:
        return list(_quoted(line, separator)) if '"' in line else list(_plain(line, separator))
    except _UnclosedError as error:
        text = 'found a " without its counterpart in the same line, expected one at the cell\'s end and "" within'
        table.problems.append(Problem(number, error.column, (), text, name))
        return []


def _plain(line: str, separator: str) -> Iterator[Field]:
    at = 1
    for part in line.split(separator):
        text = part.lstrip()
        yield text.rstrip(), at + len(part) - len(text)
        at += len(part) + 1


def _quoted(line: str, separator: str) -> Iterator[Field]:
    at, length = 0, len(line)
    while True:
        begin = at
        while begin < length and line[begin] in " \t" and line[begin] != separator:
            begin += 1
        if line[begin : begin + 1] == '"':
            text, after = _unquoted(line, begin)
            rest, _, _ = line[after:].partition(separator)
            if rest.strip():
                raise _UnclosedError(begin + 1)
            at = after + len(rest)
        else:
            end = line.find(separator, begin)
            at = length if end < 0 else end
            text = line[begin:at].rstrip()
        yield text, begin + 1
        if at >= length:
            return
        at += 1


def _unquoted(line: str, begin: int) -> tuple[str, int]:
    """The text in the quotes that open at `begin`, and where they have closed."""
    parts, at = [], begin + 1
    while True:
        end = line.find('"', at)
        if end < 0:
            raise _UnclosedError(begin + 1)
        parts.append(line[at:end])
        if line[end + 1 : end + 2] != '"':
            return "".join(parts), end + 1
        parts.append('"')
        at = end + 2
