"""Whatever is in a file: a Config or a ConfigError whose every line has a place in the file; and in bounded time."""

import copy
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from softplc.config import compose, syntax
from softplc.config.load import load
from softplc.config.models import Config
from softplc.config.problem import MOST
from softplc.errors import ConfigError

FOLDER = Path(__file__).parents[2] / "config"
TEXTS = {name: (FOLDER / f"{name}.yaml").read_text(encoding="utf-8") for name in ("minimal", "demo", "plant")}
LINE = re.compile(r"^.+:(\d+):(\d+): \S.*$")
JARGON = re.compile(r"Input should|validation error|pydantic|cannot be read as YAML")
BREAKS = re.compile("\r\n|[\n\r\x85\u2028\u2029]")
PIECES = [
    *":-#{}[]&*!|>'\"%@`,?\t \n\r\\~<=.019aB\x07\x85\u2028\ufeffµ😀",
    *["  ", "\n  ", "\n- ", ": ", "- ", "<<", "*a", "&a ", "!!str ", "---\n", ".nan"],
]


def outcome(data: bytes) -> Config | list[str]:
    """The configuration in these bytes, or the lines of the report. Any other exception fails the test."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.yaml"
        path.write_bytes(data)
        try:
            return load(path)
        except ConfigError as error:
            return list(error.lines)


def check(data: bytes) -> None:
    result = outcome(data)
    if isinstance(result, Config):
        return
    assert 1 <= len(result) <= MOST + 1
    lines = len(BREAKS.split(data.decode(errors="replace")))
    for line in result:
        match = LINE.match(line)
        assert match is not None, line
        assert int(match[1]) <= lines, line
        assert not JARGON.search(line), line


EDITS = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 12), st.sampled_from(["", *PIECES])), min_size=1, max_size=4
)


@settings(max_examples=150, deadline=None)
@given(name=st.sampled_from(["minimal", "demo"]), edits=EDITS)
def test_a_mutated_file_loads_or_is_reported(name: str, edits: list[tuple[float, int, str]]) -> None:
    text = TEXTS[name]
    for where, cut, put in edits:
        at = int(where * len(text))
        text = text[:at] + put + text[at + cut :]
    check(text.encode())


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(["minimal", "demo"]),
    edits=st.lists(
        st.tuples(st.floats(0, 0.999), st.floats(0, 0.999), st.sampled_from(["copy", "drop", "in", "out", "swap"]))
    ),
)
def test_moved_lines_load_or_are_reported(name: str, edits: list[tuple[float, float, str]]) -> None:
    lines = TEXTS[name].split("\n")
    for one, two, edit in edits:
        a, b = int(one * len(lines)), int(two * len(lines))
        if edit == "copy":
            lines.insert(b, lines[a])
        elif edit == "drop":
            lines[a] = ""
        elif edit == "swap":
            lines[a], lines[b] = lines[b], lines[a]
        else:
            lines[a] = "  " + lines[a] if edit == "in" else lines[a].removeprefix(" ")
    check("\n".join(lines).encode())


DEMO = json.dumps(YAML(typ="safe", pure=True).load(TEXTS["demo"]))
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["plc_opcua", "AxisX", "modbus", "holding:1", "ns=2;s=A", [], {}, [{}], [[]], {"type": "opcua"}]),
)


def places(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every place in a document."""
    keys = node if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
    return [path] * bool(path) + [place for key in keys for place in places(node[key], (*path, key))]


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_document_with_other_values_in_its_places_loads_or_is_reported(data: st.DataObject) -> None:
    document = json.loads(DEMO)
    for _ in range(data.draw(st.integers(1, 4))):
        *way, last = data.draw(st.sampled_from(places(document)))
        parent = document
        for key in way:
            parent = parent[key]
        if isinstance(parent, dict) and data.draw(st.booleans()):
            parent[data.draw(st.text(max_size=6))] = parent.pop(last)
        else:
            parent[last] = copy.deepcopy(data.draw(VALUES))
    check(json.dumps(document).encode())


@settings(max_examples=100, deadline=None)
@given(
    st.one_of(
        st.binary(max_size=60),
        st.lists(st.sampled_from(PIECES), max_size=40).map(lambda parts: "".join(parts).encode()),
    )
)
def test_any_bytes_load_or_are_reported(data: bytes) -> None:
    check(data)


@settings(max_examples=25, deadline=None)
@given(edits=EDITS)
def test_a_mutated_plant_loads_or_is_reported(edits: list[tuple[float, int, str]]) -> None:
    text = TEXTS["plant"]
    for where, cut, put in edits:
        at = int(where * len(text))
        text = text[:at] + put + text[at + cut :]
    check(text.encode())


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(['"{}"', "{}", "[{}]", "{{value: {}}}", "{{env: [{}]}}", "!x {}", "|\n          {}", "*{}"]))
def test_a_secret_in_the_file_is_never_shown(form: str) -> None:
    secret = "s3cr3tW0rd"
    text = TEXTS["demo"] + f"    users:\n      - name: joe\n        password: {form.format(secret)}\n"
    text = text.replace("- type: modbus\n    port: 5020", "- type: opcua\n    port: 4844")

    result = outcome(text.encode())

    assert not isinstance(result, Config)
    if form != "*{}":  # an alias: its name is no value
        assert all(secret not in line for line in result)


def bomb(levels: int, width: int) -> str:
    """Each level refers to the one before, width times: width ** levels values."""
    lines = [f"a0: &a0 [{', '.join('x' * width)}]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * width)}]" for n in range(1, levels)]
    return "\n".join(lines)


@pytest.mark.parametrize("text", [bomb(30, 9), bomb(9, 40), bomb(9, 40).replace("[", "{k: [").replace("]", "]}")])
def test_a_yaml_bomb_is_not_expanded(text: str) -> None:
    document = syntax.read(text)

    assert document.root is not None
    assert document.root.size <= 1.01 * compose.MOST_VALUES  # an alias that is refused keeps its own place
    assert any("more than 300000 values" in problem.text for problem in document.problems)
    check(text.encode())


def test_merged_keys_are_not_multiplied() -> None:
    text = "a0: &a0 {x: 1}\n" + "\n".join(
        f"a{n}: &a{n} {{<<: [{', '.join([f'*a{n - 1}'] * 9)}], k{n}: 1}}" for n in range(1, 40)
    )

    document = syntax.read(text)

    assert document.root is not None
    assert document.root.size <= 1.01 * compose.MOST_VALUES  # an alias that is refused keeps its own place


@pytest.mark.parametrize("unit", ["[", "{", "- ", "? ", "{a: ", "!", "&a ", "'", '"', "# ", "a: ", "\t", "- &a\n"])
def test_a_long_run_of_one_sign_is_read_or_refused_at_once(unit: str) -> None:
    check((unit * (100_000 // len(unit))).encode())
