"""YAML syntax errors in plain words."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from softplc.config.problem import Problem

_BLOCK_END: Final = "this line does not fit the indentation of the block that starts in line {line}; align it"
_WORDS: Final[tuple[tuple[str, str], ...]] = (
    (r"could not find expected ':'", "found no `: ` after the key in line {line}, expected key: value"),
    (r"expected ',' or '\]'", "the list that starts with [ in line {line} is not closed, expected , or ]"),
    (r"expected ',' or '\}'", "the block that starts with {{ in line {line} is not closed, expected , or }}"),
    (r"expected <block end>", _BLOCK_END),
    (r"unexpected end of stream", "the quote that opens in line {line}, column {column}, is not closed"),
    (r"unexpected document separator", "the quote that opens in line {line}, column {column}, is not closed"),
    (r"unknown escape character '(.+)'", r"found \{0} in double quotes; write \\ for a backslash, or single quotes"),
    (r"escape sequence of (\d+)", "expected {0} hexadecimal digits after the backslash"),
    (r"sequence entries are not allowed here", "a list entry (- ) cannot start here; put it on a line of its own"),
    (r"mapping keys are not allowed here", "a key cannot start here"),
    (r"expected the node content", "found nothing, expected a value"),
    (r"incompatible YAML document", "found another version of YAML, expected 1.2; leave the %YAML line out"),
    (r"duplicate YAML directive", "found a second %YAML line, expected at most one"),
    (r"undefined tag handle", "found a YAML tag (!…), expected none; put the text in quotes"),
    (r"while (?:scanning|parsing) (?:an?|the) tag", "found a YAML tag (!…), expected none; put the text in quotes"),
    (r"while scanning an (anchor|alias)", "expected a name of letters and digits after & or *; quote a text"),
    (r"while scanning a directive", "found %, expected no directive; put a text that starts with % in quotes"),
    (r"while scanning a block scalar", "expected nothing after | or > but + or - or the indentation's width"),
    (r"document start|after document end", "found text after the end of the document, expected one document"),
)


@dataclass(frozen=True, slots=True)
class Quote:
    """A quoted text over several lines: where it opens, and the line in which it ends."""

    line: int
    column: int
    last: int


def syntax_problems(error: Any, text: str, opened: int, quote: Quote | None) -> Iterator[Problem]:
    """What a MarkedYAMLError says, at the place where reading stopped; a tab in every line that is indented by one.

    `opened`: line where the innermost list or block starts that is still open; `quote`: the last long one.
    """
    mark = error.problem_mark or error.context_mark
    line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
    lines = text.splitlines()
    there = lines[line - 1] if line <= len(lines) else ""
    if "'\\t'" in str(error.problem):
        yield from _tabs(lines, line, column)
    elif quote is not None and quote.last == line:
        opens = f"line {quote.line}, column {quote.column}"
        words = f"the quoted text that opens in {opens}, ends here, expected its closing quote further up"
        yield Problem(line, column, (), words)
    else:
        yield Problem(line, column, (), _words(error, there, column, opened))


def _tabs(lines: list[str], line: int, column: int) -> Iterator[Problem]:
    found = [(line, column)]
    for number, content in enumerate(lines[line:], line + 1):
        indent = content[: len(content) - len(content.lstrip())]
        if "\t" in indent and content.strip():
            found.append((number, indent.index("\t") + 1))
    for place in found:
        yield Problem(*place, (), "found a tab, expected blanks; indent with two blanks for each level")


def _words(error: Any, there: str, column: int, opened: int) -> str:
    problem = str(error.problem)
    if "node content, but found '<stream end>'" in problem:
        return f"the file ends before the list or block that starts in line {opened} is closed"
    if problem == "mapping values are not allowed here":
        if ": " in there[: column - 1]:
            return "found a second `: ` in one line; put the value in quotes, or the second key on a line of its own"
        return "found a key where none can be; align it with the keys around it, or close the line before it"
    cannot_start = re.match(r"found character (['\"])(.+)\1 that cannot start any token", problem)
    if cannot_start is not None:
        return f"a value cannot start with {cannot_start[2]}; put it in quotes"
    context = error.context_mark
    line, column = (context.line + 1, context.column + 1) if context is not None else (1, 1)
    for pattern, words in _WORDS:
        match = re.search(pattern, problem) or re.search(pattern, str(error.context))
        if match is not None:
            return words.format(*match.groups(), line=line, column=column)
    return f"cannot be read as YAML: {problem}"
