"""The text of a file, and what makes it unreadable: not there, too large, binary, not UTF-8, control characters."""

import stat
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from softplc.config.problem import Problem

MOST_BYTES: Final = 4 * 1024 * 1024
_UTF_16_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")  # byte order marks, as some editors write them
_CONTROL: Final = dict.fromkeys(
    (*range(9), 11, 12, *range(14, 32), *range(127, 133), *range(134, 160), 0xFFFE, 0xFFFF)
)


def read_text(path: Path, kind: str = "YAML") -> tuple[str | None, list[Problem]]:
    """The text (None: there is none) and the problems found; bad characters are replaced, so that it can be read.

    `kind` is what the file should be, YAML or CSV.
    """
    data = _bytes(path, kind)
    if isinstance(data, bytes):
        wrong = _no_text(data, kind)
        return (None, [_whole(wrong)]) if wrong else _decoded(data.removeprefix(b"\xef\xbb\xbf"))
    return None, [_whole(data)]


def _bytes(path: Path, kind: str) -> bytes | str:
    """The file's bytes, one more than are allowed at most; or why there are none."""
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            with path.open("rb") as file:
                return file.read(MOST_BYTES + 1)
    except FileNotFoundError:
        return f"there is no such file{_similar(path, kind)}"
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return f"cannot be read ({reason}), expected a readable file"
    return f"this is {'a directory' if stat.S_ISDIR(mode) else 'no regular file'}, expected a {kind} file"


def _no_text(data: bytes, kind: str) -> str:
    """Why these bytes are no text file; empty when they may be one."""
    if len(data) > MOST_BYTES:
        return f"larger than {MOST_BYTES // 2**20} MiB, expected a smaller file"
    if data[:2] in _UTF_16_MARKS:
        return "the file is UTF-16, expected UTF-8; save it as UTF-8"
    return f"the file is binary, expected a {kind} text" if b"\0" in data else ""


def _whole(text: str) -> Problem:
    return Problem(1, 1, (), text)


def _similar(path: Path, kind: str) -> str:
    suffixes = (".yaml", ".yml") if kind == "YAML" else (f".{kind.lower()}",)
    try:
        names = [entry.name for entry in path.parent.iterdir() if entry.suffix in suffixes]
    except OSError:
        return f", nor a directory {path.parent}"
    near = get_close_matches(path.name, names, n=1)
    return f"; did you mean {path.with_name(near[0])}?" if near else f", expected a {kind} file"


def _decoded(data: bytes) -> tuple[str, list[Problem]]:
    try:
        text, problems = data.decode(), []
    except UnicodeDecodeError:
        text, problems = data.decode(errors="replace"), _undecodable(data)
    if any(ord(letter) in _CONTROL for letter in set(text)):
        problems += _control_characters(text)
        text = text.translate(dict.fromkeys(_CONTROL, " "))
    return text, problems


def _undecodable(data: bytes) -> list[Problem]:
    """The first byte of each line that is not UTF-8."""
    problems = []
    for number, line in enumerate(data.split(b"\n"), 1):
        try:
            line.decode()
        except UnicodeDecodeError as error:
            column = len(line[: error.start].decode()) + 1
            text = f"found the byte 0x{line[error.start]:02X}, which is not UTF-8; save the file as UTF-8"
            problems.append(Problem(number, column, (), text))
    return problems


def _control_characters(text: str) -> list[Problem]:
    """The first control character of each line."""
    problems = []
    for number, line in enumerate(text.split("\n"), 1):
        column = next((at for at, letter in enumerate(line, 1) if ord(letter) in _CONTROL), None)
        if column is not None:
            text = f"found the control character \\u{ord(line[column - 1]):04x}, expected none; remove it"
            problems.append(Problem(number, column, (), text))
    return problems
