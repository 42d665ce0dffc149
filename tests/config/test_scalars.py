"""What an unquoted text means: YAML 1.2's core schema, tables 10.3.2, with leading zeros as text."""

import math

import pytest

from softplc.config.scalars import resolve
from softplc.config.words import axis_unit, near


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *((text, None) for text in ("", "~", "null", "Null", "NULL")),
        *((text, True) for text in ("true", "True", "TRUE")),
        *((text, False) for text in ("false", "False", "FALSE")),
        ("0", 0),
        ("-12", -12),
        ("+7", 7),
        ("0o17", 15),
        ("0xFf", 255),
        ("1.5", 1.5),
        ("-.5", -0.5),
        ("1.", 1.0),
        ("1e3", 1000.0),
        ("12e-03", 0.012),
        ("00.5", 0.5),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("1e999", math.inf),
    ],
)
def test_a_word_of_the_core_schema_has_its_value_and_type(text: str, value: object) -> None:
    assert resolve(text) == value
    assert type(resolve(text)) is type(value)


@pytest.mark.parametrize(
    "text",
    [
        "yes",
        "no",
        "on",
        "off",
        "y",
        "N",
        "nUll",
        "tRue",
        "007",
        "00001",
        "-01",
        "1_000",
        "1,5",
        "0b11",
        "12:30",
        "2024-05-01",
        "1e",
        "1e+",
        ".",
        "-",
        "+",
        "--",
        ".nano",
        "0x",
        "0xg",
        "ns=2;s=A",
        "holding:0",
        "1.2.3",
        "<<",
    ],
)
def test_everything_else_is_text(text: str) -> None:
    assert resolve(text) == text


def test_nan_is_a_number_and_a_megabyte_of_digits_is_not() -> None:
    value = resolve(".nan")
    assert isinstance(value, float)
    assert math.isnan(value)
    assert resolve("1" * 1_000_000) == "1" * 1_000_000


@pytest.mark.parametrize(
    ("pattern", "unit", "words"),
    [
        ("unit²", "mm", "mm²"),
        ("(unit/s)²", "mm", "(mm/s)²"),
        ("unit²", "m/s", "(m/s)²"),
        ("unit²", "", ""),
        ("(unit/s)²", "", "(1/s)²"),
        ("unit", None, "axis unit"),
        ("ms", "mm", "ms"),
    ],
)
def test_a_unit_of_the_schema_takes_the_axis_own(pattern: str, unit: str | None, words: str) -> None:
    assert axis_unit(pattern, unit) == words


@pytest.mark.parametrize(
    ("word", "names", "meant"),
    [
        ("q_xdot", ["q_x", "q_x_dot", "r_x"], "q_x_dot"),
        ("Timeout", ["timeout_ms", "type"], "timeout_ms"),
        ("byte-order", ["byte_order"], "byte_order"),
        ("slave", ["unit_id", "name"], "unit_id"),
        ("slave", ["name"], None),
        ("colour", ["name", "unit", "range"], None),
        ("plc3", ["plc1", "plc2"], "plc1"),
    ],
)
def test_a_guess_is_the_most_similar_name_or_none(word: str, names: list[str], meant: str | None) -> None:
    guess = near(word, names)

    assert (guess[0] if guess else None) == meant
