"""Templates: what `for` and its placeholders make, from ranges, lists and tables; ten thousand axes are no burden."""

import re
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.config import expand, placeholders, syntax
from softplc.config.load import load, load_model
from softplc.config.models import Config
from softplc.config.placeholders import PlaceholderError
from softplc.config.problem import MOST
from softplc.config.scalars import resolve
from softplc.config.table import read_table
from softplc.config.tree import Cell
from softplc.emulator.scenario import Scenario
from softplc.errors import ConfigError
from tests.config.test_mutations import EDITS, JARGON

FOLDER = Path(__file__).parents[2] / "config"
SOURCES = "sources: [{name: plc, type: opcua, url: 'opc.tcp://127.0.0.1:4841'}]\naxes:\n"
AXIS = "    input: {source: plc, node: 'ns=2;s=%s'}\n    observer: {type: aoi, r_x: 1}\n"


@pytest.fixture
def loaded(tmp_path: Path) -> Callable[..., Config]:
    def make(text: str, **tables: str) -> Config:
        for name, content in tables.items():
            (tmp_path / f"{name}.csv").write_text(content, encoding="utf-8")
        (tmp_path / "x.yaml").write_text(text, encoding="utf-8")
        return load(tmp_path / "x.yaml")

    return make


def cells(**values: Any) -> dict[str, Cell]:
    return {
        name: Cell(str(value), resolve(value) if isinstance(value, str) else value) for name, value in values.items()
    }


def test_a_range_makes_an_axis_for_each_number(loaded: Callable[..., Config]) -> None:
    config = loaded(SOURCES + "  - for: 8..12\n    name: Axis{i:03}\n" + AXIS % "DB1.Axis[{i}].X")

    assert [axis.name for axis in config.axes] == ["Axis008", "Axis009", "Axis010", "Axis011", "Axis012"]
    assert [axis.input.node for axis in config.axes][-1] == "ns=2;s=DB1.Axis[12].X"  # type: ignore[union-attr]


def test_entries_with_and_without_for_keep_their_order(loaded: Callable[..., Config]) -> None:
    axis = "  - name: %s\n" + AXIS % "x"
    config = loaded(
        SOURCES + axis % "First" + "  - for: 0..4 step 2\n    name: M{i}\n" + AXIS % "{i}" + axis % "Last"
    )

    assert [axis.name for axis in config.axes] == ["First", "M0", "M2", "M4", "Last"]


def test_names_make_every_combination_and_n_counts_them(loaded: Callable[..., Config]) -> None:
    text = "  - for: {cell: 1..2, side: [Left, Right]}\n    name: '{side}{cell}'\n" + AXIS % "{n}"
    config = loaded(SOURCES + text)

    assert [axis.name for axis in config.axes] == ["Left1", "Right1", "Left2", "Right2"]
    assert [axis.input.node for axis in config.axes] == [f"ns=2;s={n}" for n in range(4)]  # type: ignore[union-attr]


def test_sources_and_placements_may_be_templates(loaded: Callable[..., Config]) -> None:
    config = loaded(
        "sources:\n  - {for: 1..3, name: 'plc{i}', type: modbus, transport: {host: 'd{i}', port: '{500 + i}'}}\n"
        "axes:\n  - for: 1..3\n    name: A{i}\n    input: {source: 'plc{i}', address: '{40001 + 2 * i}'}\n"
        "    observer: {type: aoi, r_x: 1}\n"
        "publishers:\n  - {type: modbus, placements: [{for: [1, 3], axis: 'A{i}', address: '{4000 + 64 * i}'}]}\n"
    )

    assert [source.transport.port for source in config.sources] == [501, 502, 503]  # type: ignore[union-attr]
    assert [str(axis.input.address) for axis in config.axes] == ["40003", "40005", "40007"]  # type: ignore[union-attr]
    assert [(place.axis, place.address) for place in config.publishers[0].placements] == [  # type: ignore[union-attr]
        ("A1", 4064),
        ("A3", 4192),
    ]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_table_makes_an_axis_for_each_row(loaded: Callable[..., Config], separator: str) -> None:
    table = 'Name,"Noise, mm²",Tag\nA,0.5,"x ""1"""\n\n# B,7,y\nC,,z\n'.replace(", mm", "\0").replace(",", separator)
    text = "  - for: t.csv\n    name: '{Name}'\n    input: {source: plc, node: 'ns=2;s={Tag}'}\n"
    text += "    observer: {type: aoi, r_x: 1, q_x: '{Noise, mm²}'}\n"
    config = loaded(SOURCES + text, t=table.replace("\0", ", mm"))

    assert [axis.name for axis in config.axes] == ["A", "C"]
    assert [axis.input.node for axis in config.axes] == ['ns=2;s=x "1"', "ns=2;s=z"]  # type: ignore[union-attr]
    first, second = (axis.observer.q_x for axis in config.axes)  # type: ignore[union-attr]
    assert first == 0.5
    assert second == 0.001  # an empty cell leaves the key out


@pytest.mark.parametrize("empty", [",", " , ", ",,,,,", '"",""', '""'])
def test_a_row_of_empty_cells_is_an_empty_line(tmp_path: Path, empty: str) -> None:
    (tmp_path / "t.csv").write_text(f"Name,Tag\nA,x\n{empty}\nB,y\n{empty}\n", encoding="utf-8")

    table = read_table(tmp_path / "t.csv", "t.csv")

    assert table.problems == []
    assert [(row["Name"].text, row["Name"].line) for row in table.rows] == [("A", 2), ("B", 4)]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("{i}", 7),
        ("{ i }", 7),
        ("{i:d}", "7"),
        ("{i:04}", "0007"),
        ("{i:x}", "7"),
        ("{x:.2f}", "1.50"),
        ("{i/2}", 3.5),
        ("{(i + 1) / 2}", 4),
        ("{-i // 2}", -4),
        ("{i % 4 * 10 - 1}", 29),
        ("{x}", 1.5),
        ("{code}", "007"),
        ("A{code}", "A007"),
        ("{code:d}{i}", PlaceholderError),
        ("{i}{i}", 77),
        ("{{i}}", "{i}"),
        ("a{{{i}}}", "a{7}"),
        ("{x:d}", PlaceholderError),
        ("{i / 0}", PlaceholderError),
        ("{code * 2}", PlaceholderError),
        ("{i ** 2}", PlaceholderError),
        ("{'a' * 9}", PlaceholderError),
        ("{i.real}", PlaceholderError),
        ("{abs(i)}", PlaceholderError),
        ("{True}", PlaceholderError),
        ("{i:>40000}", PlaceholderError),
        ("{i", PlaceholderError),
        ("i}", PlaceholderError),
        ("{}", PlaceholderError),
        ("{i:}", PlaceholderError),
        ("{" + "(" * 150 + "i" + ")" * 40 + "}", PlaceholderError),
        ("{" + "+".join(["i"] * 150) + "}", PlaceholderError),
    ],
)
def test_a_placeholder_says_its_value_or_what_is_wrong(text: str, value: Any) -> None:
    row = cells(i=7, x="1.5", code="007")

    def fill() -> Any:
        pattern = placeholders.read(text, frozenset(row), quoted=False)
        return text if pattern is None else pattern.fill(row)[0]

    if value is PlaceholderError:
        with pytest.raises(PlaceholderError):
            fill()
    else:
        assert fill() == value
        assert type(fill()) is type(value)


@pytest.mark.parametrize(
    "text", ["{" + "*".join("i" * 12) + "}", "{" + "*".join("i" * 90) + ":d}", "A{i*i*i}", "{i:.2f}", "{i / 3}"]
)
def test_a_number_of_hundreds_of_digits_is_too_large(text: str) -> None:
    row = cells(i=int("9" * 399))  # the longest that a table may have

    pattern = placeholders.read(text, frozenset(row), quoted=False)

    assert pattern is not None
    with pytest.raises(PlaceholderError, match="too large"):
        pattern.fill(row)


def test_quotes_keep_a_mixed_text_a_text() -> None:
    row = cells(i=7)

    pattern = placeholders.read("4000{i}", frozenset(row), quoted=True)

    assert pattern is not None
    assert pattern.fill(row) == ("40007", "40007")


@given(number=st.integers(-(10**6), 10**6), text=st.text("i0123456789+-*/%() .{}:dx", max_size=25))
@settings(max_examples=200, deadline=None)
def test_any_placeholder_is_computed_or_refused(number: int, text: str) -> None:
    row = cells(i=number)
    try:
        pattern = placeholders.read("{" + text + "}", frozenset(row), quoted=True)
        if pattern is not None:
            pattern.fill(row)
    except PlaceholderError as error:
        assert "expected" in str(error) or "there is no" in str(error)


def test_what_has_no_placeholder_is_one_node_for_all_instances(tmp_path: Path) -> None:
    root = syntax.read(SOURCES + "  - for: 1..50\n    name: A{i}\n" + AXIS % "{i}").root
    assert root is not None

    made = expand.expand(root, tmp_path)

    axes = root.entries["axes"].value.items  # type: ignore[union-attr]
    assert len(axes) == 50
    assert len({id(axis.entries["observer"].value) for axis in axes}) == 1
    assert len({id(axis.entries["input"].value) for axis in axes}) == 50
    assert made.origin(("axes", 49, "name")) == (("axes", 0, "name"), made.origin(("axes", 0))[1], "i=50")


def test_ten_thousand_axes_cost_no_more_each_than_a_thousand(loaded: Callable[..., Config]) -> None:
    costs = []
    for count in (1_000, 10_000):
        text = SOURCES + f"  - for: 1..{count}\n    name: A{{i}}\n" + AXIS % "A{i}.Position"
        start = process_time()
        assert len(loaded(text).axes) == count
        costs.append((process_time() - start) / count)

    assert costs[1] < 4 * costs[0] + 1e-4  # linear: quadratic would be ten times; the rest is for a busy machine


def test_what_is_wrong_in_all_instances_is_said_once(loaded: Callable[..., Config]) -> None:
    text = SOURCES + "  - for: 1..3000\n    name: A{i}\n    unti: mm\n    range: [1, 0]\n" + AXIS % "{i}"
    with pytest.raises(ConfigError) as raised:
        loaded(text.replace("r_x: 1", "r_x: -1, q_xdot: 1").replace("source: plc", "source: 'plc{i}'"))

    lines = [line.partition("x.yaml:")[2] for line in raised.value.lines]
    assert [line.split(" ", 1)[0] for line in lines] == [
        "5:5:",
        "6:12:",
        "7:21:",
        "8:32:",
        "8:36:",
    ]
    assert "(first in i=1)" in lines[0]


def test_instances_are_bounded(loaded: Callable[..., Config]) -> None:
    text = "  - for: 1..100000\n    name: A{i}\n    write_back: [" + "{}, " * 20 + "{}]\n" + AXIS % "{i}"
    with pytest.raises(ConfigError, match=r"more than 2000000 values in all instances"):
        loaded(SOURCES + text)


def test_the_emulated_plc_takes_templates_as_well(tmp_path: Path) -> None:
    axis = "axes:\n  - {for: 1..100, name: 'Axis{i}', motion: {type: sine, amplitude: '{i}', period_s: 10}}\n"
    (tmp_path / "scenario.yaml").write_text(axis + "opcua: {port: 4841}\n", encoding="utf-8")

    scenario = load_model(tmp_path / "scenario.yaml", Scenario)

    assert [axis.name for axis in scenario.axes][-1] == "Axis100"


def test_for_is_no_key_elsewhere(loaded: Callable[..., Config]) -> None:
    with pytest.raises(ConfigError, match=r"publishers\[0\]\.for: unknown key"):
        loaded(SOURCES + "  - name: A\n" + AXIS % "a" + "publishers:\n  - {for: 1..2, type: opcua}\n")


TABLE = (FOLDER / "table.csv").read_text(encoding="utf-8")
LINE = re.compile(r"^.+\.(yaml|csv):(\d+):(\d+): \S.*$")


def check(folder: Path, text: str, table: str) -> None:
    (folder / "table.yaml").write_bytes(text.encode("utf-8", "surrogatepass"))
    (folder / "table.csv").write_bytes(table.encode("utf-8", "surrogatepass"))
    try:
        load(folder / "table.yaml")
    except ConfigError as error:
        assert 1 <= len(error.lines) <= MOST + 1
        for line in error.lines:
            match = LINE.match(line)
            assert match is not None, line
            file = text if match[1] == "yaml" else table
            assert int(match[2]) <= len(re.split("\r\n|[\n\r\x85\u2028\u2029]", file)), line
            assert not JARGON.search(line), line


def edited(text: str, edits: list[tuple[float, int, str]]) -> str:
    for where, cut, put in edits:
        at = int(where * len(text))
        text = text[:at] + put + text[at + cut :]
    return text


@settings(max_examples=80, deadline=None)
@given(edits=EDITS)
def test_a_mutated_table_loads_or_is_reported(edits: list[tuple[float, int, str]], tmp_path_factory: Any) -> None:
    folder = tmp_path_factory.getbasetemp()
    check(folder, (FOLDER / "table.yaml").read_text(encoding="utf-8"), edited(TABLE, edits))


@settings(max_examples=80, deadline=None)
@given(edits=EDITS, name=st.sampled_from(["table", "thousand"]))
def test_a_mutated_template_loads_or_is_reported(
    edits: list[tuple[float, int, str]], name: str, tmp_path_factory: Any
) -> None:
    text = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8").replace("axis: 1..100", "axis: 1..4")
    check(tmp_path_factory.getbasetemp(), edited(text, edits), TABLE)


@pytest.mark.parametrize(
    "data", [b"", b"\0", b"a,b\n\xff,1\n", b"\xff\xfea\0", b"a,a\n1,2\n", b"a,\n1,2", b"a,b\n1\n"]
)
def test_a_table_that_cannot_be_read_says_why(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "t.csv").write_bytes(data)

    problems = read_table(tmp_path / "t.csv", "t.csv").problems

    assert problems
    assert all(problem.file == "t.csv" for problem in problems)
