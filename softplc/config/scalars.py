"""Plain scalars of YAML 1.2 by the core schema (specification 1.2.2, 10.3.2): what is a number and what is text.

`no`, `off`, `12:30`, `1_000` and `2024-05-01` are text here, as the schema says. So is an integer with leading
zeros, against the schema: `00001` is a Modbus coil, and `010` is ten to some and eight to others.
"""

import re
from typing import Final

Value = str | int | float | bool | None

_NULLS: Final = frozenset(("", "~", "null", "Null", "NULL"))
_BOOLEANS: Final = {
    "true": True,
    "True": True,
    "TRUE": True,
    "false": False,
    "False": False,
    "FALSE": False,
}
_INTEGER: Final = re.compile(r"[-+]?(?:0|[1-9][0-9]*)")
_OTHER_BASE: Final = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT: Final = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_SPECIAL: Final = {
    sign + dot: float(sign + "inf") for sign in ("", "+", "-") for dot in (".inf", ".Inf", ".INF")
} | dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan"))
_LONGEST_NUMBER: Final = 400  # characters; beyond it is text, so that nothing converts a megabyte of digits
_FIRST_OF_NUMBER: Final = frozenset("-+.0123456789")


def resolve(text: str) -> Value:
    """The value of a plain (unquoted) scalar."""
    if text[:1] in _FIRST_OF_NUMBER and len(text) <= _LONGEST_NUMBER:
        return _number(text)
    if text in _NULLS:
        return None
    return _BOOLEANS.get(text, text)


def _number(text: str) -> str | int | float:
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return text if text.lstrip("-+").isdecimal() else float(text)
    if _OTHER_BASE.fullmatch(text):
        return int(text, 0)
    return _SPECIAL.get(text, text)
