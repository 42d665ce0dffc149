"""One thing that is wrong in a file, with its place; printed as `file:line:column: path: text`."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

MOST: Final = 1000  # lines of one report; nobody reads more, and a hostile file must not make millions
WHOLE_FILE: Final = "(file)"
LONG: Final = 300  # characters of a sentence that a parser made of a text from the file
Key = str | int
Path = tuple[Key, ...]


@dataclass(frozen=True, slots=True, order=True)
class Problem:
    """What was found and what would be right. `line` and `column` count from 1, in characters."""

    line: int
    column: int
    path: Path
    text: str
    file: str = ""  # another one than the configuration: a table that it names

    def sentence(self, file: str) -> str:
        """The problem as one line of a report."""
        return f"{self.file or file}:{self.line}:{self.column}: {path_text(self.path)}: {self.text}"


def path_text(path: Path) -> str:
    """A path as people write it: `axes[0].observer.r_x`; the file itself when it is empty."""
    text = ""
    for key in path:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += f".{_key(key)}" if text else _key(key)
    return text or WHOLE_FILE


def _key(key: str) -> str:
    """A key as it is; in quotes where nobody would see it otherwise."""
    return shown(key) if key.strip() == key != "" else f'"{shown(key)}"'


def shown(text: str, most: int = 40) -> str:
    """A text from the file, fit for one line of a report: short, and without control characters."""
    short = text if len(text) <= most else text[: most - 1] + "…"
    return "".join(letter if letter.isprintable() else f"\\u{ord(letter):04x}" for letter in short)


def report(problems: Iterable[Problem], file: str) -> list[str]:
    """All problems as lines, by position, each once."""
    ordered = sorted(
        set(problems),
        key=lambda problem: (problem.file, problem.line, problem.column, path_text(problem.path), problem.text),
    )
    lines = [problem.sentence(file) for problem in ordered[:MOST]]
    if len(ordered) > MOST:
        first = ordered[MOST]
        more = len(ordered) - MOST
        lines.append(
            Problem(first.line, first.column, (), f"{more} more errors follow; mend these first").sentence(file)
        )
    return lines
