"""Placeholders of a template: `{i}`, `{2*i + 1}`, `{i:04}`, `{{` for a brace; read once, filled for each instance.

Arithmetic knows whole and decimal numbers, names, `+ - * / // %` and brackets. Nothing else is ever evaluated.
"""

import ast
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from softplc.config.problem import shown
from softplc.config.scalars import Value, resolve
from softplc.config.tree import Cell

Row = Mapping[str, Cell]
"""What the names of one instance stand for."""

_LONGEST: Final = 200  # characters of one placeholder
_PIECES: Final = re.compile(r"\{\{|\}\}|\{[^{}]*\}|[{}]|[^{}]+")
_FORM: Final = re.compile(r"0?[0-9]{0,2}(?:\.[0-9]{1,2}f|[dxX]|f)?")
_OPERATORS: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_MOST_BITS: Final = 1024  # of a whole number; what is beyond takes ever longer, and no double holds it
_TOO_LARGE: Final = "found a number that is too large, expected a smaller one"
_WHAT: Final = "a name or arithmetic of numbers, names, + - * / // % and brackets"


class PlaceholderError(ValueError):
    """A placeholder that cannot be read, or not be filled for an instance; the text says why."""


Compute = Callable[[Row], Value]


@dataclass(frozen=True, slots=True)
class _Hole:
    """One placeholder: what it is filled with, and how a number is written (empty: as it is)."""

    compute: Compute
    form: str

    def value(self, row: Row) -> Value:
        value = self.compute(row)
        if not self.form:
            return value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PlaceholderError(f"found {_said(value)}, expected a number for the format :{self.form}")
        whole = int(value) if isinstance(value, float) and value.is_integer() and self.form[-1] != "f" else value
        form = self.form if self.form[-1] in "dxXf" else self.form + "d"
        try:
            return format(whole, form)
        except OverflowError:
            raise PlaceholderError(_TOO_LARGE) from None
        except ValueError:
            raise PlaceholderError(
                f"found {value!r}, expected a whole number for the format :{self.form}, or one such as :.2f"
            ) from None


@dataclass(frozen=True, slots=True)
class Pattern:
    """A text with placeholders. `names` are all names in it."""

    parts: tuple[str | _Hole, ...]
    names: tuple[str, ...]
    quoted: bool

    def fill(self, row: Row) -> tuple[Value, str]:
        """Value and text for one instance, as if they stood in the file. Raises PlaceholderError."""
        if len(self.parts) == 1 and isinstance(self.parts[0], _Hole):
            value = self.parts[0].value(row)
            return value, _text(value)
        text = "".join(
            [part if isinstance(part, str) else _text(_raw(part, row)) for part in self.parts],
        )
        return (text if self.quoted else resolve(text)), text


def read(text: str, names: frozenset[str], *, quoted: bool) -> Pattern | None:
    """The pattern in a text, None when nothing is to be filled in. Raises PlaceholderError."""
    if "{" not in text and "}" not in text:
        return None
    parts: list[str | _Hole] = []
    used: dict[str, None] = {}
    for piece in _PIECES.findall(text):
        if piece in ("{{", "}}"):
            parts.append(piece[0])
        elif piece in ("{", "}"):
            raise PlaceholderError(f"found a single {piece}, expected a placeholder as in {{i}}, or {piece}{piece}")
        elif piece[0] == "{":
            parts.append(_placeholder(piece[1:-1], names, used))
        else:
            parts.append(piece)
    return Pattern(tuple(parts), tuple(used), quoted)


def _text(value: Value) -> str:
    return "" if value is None else ("false", "true")[value] if isinstance(value, bool) else str(value)


def _raw(hole: _Hole, row: Row) -> Value:
    """A name within a text stands for its text as written, 007 included."""
    if not hole.form and isinstance(hole.compute, _Name):
        return row[hole.compute.name].text
    return hole.value(row)


def _placeholder(text: str, names: frozenset[str], used: dict[str, None]) -> _Hole:
    if len(text) > _LONGEST:
        raise PlaceholderError(f"a placeholder of {len(text)} characters, expected at most {_LONGEST}")
    inner, colon, form = text.rpartition(":") if ":" in text else (text, "", "")
    if colon and (not form or not _FORM.fullmatch(form.strip())):
        raise PlaceholderError(f"found the format :{shown(form)}, expected one as in {{i:04}}, {{i:d}} or {{x:.2f}}")
    name = inner.strip()
    if name in names:
        used[name] = None
        return _Hole(_Name(name), form.strip())
    try:
        tree = ast.parse(name, mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError):
        raise PlaceholderError(f"found {{{shown(text)}}}, expected {_WHAT}") from None
    if isinstance(tree, ast.Name):
        raise PlaceholderError(_unknown(tree.id, names))
    return _Hole(_compile(tree, names, used), form.strip())


def _unknown(name: str, names: frozenset[str]) -> str:
    known = ", ".join(shown(each) for each in sorted(names))
    return f"there is no placeholder {{{shown(name)}}}, expected one of {known}"


@dataclass(frozen=True, slots=True)
class _Name:
    name: str

    def __call__(self, row: Row) -> Value:
        return row[self.name].value


def _compile(tree: ast.expr, names: frozenset[str], used: dict[str, None]) -> Callable[[Row], int | float]:
    """Arithmetic as a function of the names."""
    if isinstance(tree, ast.Constant) and type(tree.value) in (int, float):
        constant = tree.value
        assert isinstance(constant, int | float)
        return lambda row: constant
    if isinstance(tree, ast.Name):
        name = tree.id
        if name not in names:
            raise PlaceholderError(_unknown(name, names))
        used[name] = None
        return lambda row: _number(name, row[name].value)
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub | ast.UAdd):
        operand, sign = _compile(tree.operand, names, used), -1 if isinstance(tree.op, ast.USub) else 1
        return lambda row: sign * operand(row)
    if isinstance(tree, ast.BinOp) and (type(tree.op) in _OPERATORS or isinstance(tree.op, ast.Div)):
        left, right = _compile(tree.left, names, used), _compile(tree.right, names, used)
        compute = _OPERATORS.get(type(tree.op), _divided)
        return lambda row: _computed(compute, left(row), right(row))
    raise PlaceholderError(f"found {shown(ast.unparse(tree))} in a placeholder, expected {_WHAT}")


def _number(name: str, value: Value) -> int | float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise PlaceholderError(f"found {_said(value)} for {shown(name)}, expected a number to compute with")
    return value


def _computed(compute: Callable[[float, float], float], left: float, right: float) -> int | float:
    try:
        found = compute(left, right)
    except ZeroDivisionError:
        raise PlaceholderError("found a division by 0, expected any other number") from None
    except OverflowError:
        raise PlaceholderError(_TOO_LARGE) from None
    if isinstance(found, int) and found.bit_length() > _MOST_BITS:
        raise PlaceholderError(_TOO_LARGE)
    return found


def _divided(left: float, right: float) -> int | float:
    """A quotient, whole where it comes out even: an address is no decimal number."""
    exact = left / right
    return int(exact) if exact.is_integer() and isinstance(left, int) and isinstance(right, int) else exact


def _said(value: Value) -> str:
    return "nothing" if value is None else f"the text {shown(value)}" if isinstance(value, str) else str(value)
