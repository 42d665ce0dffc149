"""Files that are no configuration at all, and texts that are, in unusual bytes."""

from pathlib import Path

import pytest

from softplc.config.load import load, load_model
from softplc.config.source_text import MOST_BYTES
from softplc.emulator.scenario import Scenario
from softplc.errors import ConfigError
from softplc.model import Model

GOOD = """sources:
  - {name: plc1, type: opcua, url: "opc.tcp://127.0.0.1:4841"}
axes:
  - name: AxisX
    input: {source: plc1, node: ns=2;s=AxisX.Position}
    observer: {type: aoi, r_x: 1.33}
"""


def report(path: Path | str) -> list[str]:
    """The report on a file, without the file's directory."""
    with pytest.raises(ConfigError) as raised:
        load(path)
    return [line.replace(f"{Path(path).parent}/", "") for line in raised.value.lines]


def written(directory: Path, data: bytes) -> Path:
    path = directory / "x.yaml"
    path.write_bytes(data)
    return path


def test_a_file_that_is_not_there_is_named_with_the_nearest_one(tmp_path: Path) -> None:
    (tmp_path / "plant.yaml").write_text(GOOD)

    assert report(tmp_path / "plnt.yaml") == [
        "plnt.yaml:1:1: (file): there is no such file; did you mean plant.yaml?"
    ]


def test_a_directory_that_is_not_there_is_named(tmp_path: Path) -> None:
    assert [f"x.yaml:1:1: (file): there is no such file, nor a directory {tmp_path}/no"] == report(
        tmp_path / "no/x.yaml"
    )


def test_a_directory_and_a_device_are_no_files(tmp_path: Path) -> None:
    assert "this is a directory, expected a YAML file" in report(tmp_path)[0]
    assert "this is no regular file, expected a YAML file" in report("/dev/zero")[0]


def test_a_file_that_cannot_be_read_says_why() -> None:
    assert "cannot be read (Input/output error), expected a readable file" in report("/proc/self/mem")[0]


def test_a_path_that_no_system_knows_says_so() -> None:
    assert "cannot be read" in report("x\0.yaml")[0]


def test_a_file_over_the_limit_is_not_read(tmp_path: Path) -> None:
    just_fits = GOOD.encode() + b"#" * (MOST_BYTES - len(GOOD))

    assert load(written(tmp_path, just_fits)).axes[0].name == "AxisX"
    path = written(tmp_path, just_fits + b"#")
    assert report(path) == ["x.yaml:1:1: (file): larger than 4 MiB, expected a smaller file"]


def test_binary_and_utf_16_are_named_as_such(tmp_path: Path) -> None:
    assert report(written(tmp_path, b"\x7fELF\0")) == ["x.yaml:1:1: (file): the file is binary, expected a YAML text"]
    utf_16 = "x.yaml:1:1: (file): the file is UTF-16, expected UTF-8; save it as UTF-8"
    assert [utf_16] == report(written(tmp_path, GOOD.encode("utf-16")))


def test_bytes_that_are_not_utf_8_are_found_and_the_rest_is_checked(tmp_path: Path) -> None:
    text = GOOD.encode().replace(b"r_x: 1.33", b"r_x: -1") + b"# \xb5m\n# \xe9\n"

    assert report(written(tmp_path, text)) == [
        "x.yaml:6:32: axes[0].observer.r_x: found -1, expected a number greater than 0",
        "x.yaml:7:3: (file): found the byte 0xB5, which is not UTF-8; save the file as UTF-8",
        "x.yaml:8:3: (file): found the byte 0xE9, which is not UTF-8; save the file as UTF-8",
    ]


def test_control_characters_are_found_and_the_rest_is_checked(tmp_path: Path) -> None:
    text = GOOD.replace("r_x: 1.33", "r_x: -1") + "# bell \x07\n"

    assert report(written(tmp_path, text.encode())) == [
        "x.yaml:6:32: axes[0].observer.r_x: found -1, expected a number greater than 0",
        "x.yaml:7:8: (file): found the control character \\u0007, expected none; remove it",
    ]


@pytest.mark.parametrize("change", [lambda text: "\ufeff" + text, lambda text: text.replace("\n", "\r\n")])
def test_a_byte_order_mark_and_crlf_change_no_position(tmp_path: Path, change: object) -> None:
    assert callable(change)
    good, bad = change(GOOD), change(GOOD.replace("r_x: 1.33", "r_x: -1"))

    assert load(written(tmp_path, good.encode())).axes[0].observer.r_x == 1.33
    assert report(written(tmp_path, bad.encode())) == [
        "x.yaml:6:32: axes[0].observer.r_x: found -1, expected a number greater than 0"
    ]


def test_columns_count_characters(tmp_path: Path) -> None:
    text = GOOD.replace("    observer:", "    unit: µm²\n    observer:").replace("{type: aoi", '{type: aoi, "µµµ": 1')

    assert [line.partition(",")[0] for line in report(written(tmp_path, text.encode()))] == [
        "x.yaml:7:27: axes[0].observer.µµµ: unknown key"
    ]


def test_an_emulated_plc_is_told_from_a_configuration(tmp_path: Path) -> None:
    plc = "axes:\n  - name: AxisX\n    motion: {type: constant}\nmodbus: {port: 5021}\n"

    assert report(written(tmp_path, plc.encode())) == [
        "x.yaml:1:1: (file): this is an emulated PLC, for softplc emulate; "
        "expected a configuration: sources, axes, publishers"
    ]
    with pytest.raises(ConfigError) as raised:
        load_model(written(tmp_path, GOOD.encode()), Scenario)
    (line,) = raised.value.lines
    assert "this is a configuration, for softplc run; expected an emulated PLC" in line


def test_json_is_read_as_well(tmp_path: Path) -> None:
    text = '{"sources": [{"name": "a", "type": "replay", "file": "r.csv"}], "axes": [{"name": "A", '
    text += '"input": {"source": "a", "column": "x"}, "observer": {"type": "aoi", "r_x": 1e-3}}]}'

    assert load(written(tmp_path, text.encode())).axes[0].observer.r_x == 0.001


def test_yes_and_leading_zeros_are_text_and_merged_keys_are_taken(tmp_path: Path) -> None:
    text = """
x-base: &base {type: aoi, r_x: 1, q_x: 2}
sources:
  - {name: on, type: modbus, transport: {host: 10.0.0.1}}
axes:
  - name: yes
    input: {source: on, address: 00005, data_type: bool}
    observer: {<<: *base, q_x: 3}
"""
    path = written(tmp_path, text.encode())
    assert report(path) == [
        "x.yaml:2:1: x-base: unknown key, expected one of tasks, sources, axes, publishers, realtime, log"
    ]
    path = written(tmp_path, text.replace("x-base: &base", "#").encode().replace(b"<<: *base", b"type: aoi, r_x: 1"))
    config = load(path)
    assert config.axes[0].name == "yes"
    assert config.axes[0].observer.q_x == 3


class Recipe(Model):
    """Any model."""

    grams: float
    steps: tuple[str, ...] = ()


def test_any_model_is_read_with_the_same_care(tmp_path: Path) -> None:
    assert load_model(written(tmp_path, b"grams: 3\nsteps: [stir]\n"), Recipe) == Recipe(grams=3.0, steps=("stir",))
    with pytest.raises(ConfigError) as raised:
        load_model(written(tmp_path, b"gram: '3'\nsteps: [1]\n"), Recipe)
    assert [line.partition("x.yaml:")[2] for line in raised.value.lines] == [
        "1:1: gram: unknown key; did you mean grams?",
        '1:7: grams: found the text "3", expected a number; remove the quotes',
        "2:9: steps[0]: found 1, expected a text; put it in quotes when it is meant as text",
    ]


def test_a_report_ends_after_a_thousand_errors_and_says_how_many_more_there_are(tmp_path: Path) -> None:
    lines = report(written(tmp_path, (GOOD + "".join(f"strange{n}: 1\n" for n in range(1500))).encode()))

    assert len(lines) == 1001
    assert lines[0] == (
        "x.yaml:7:1: strange0: unknown key, expected one of tasks, sources, axes, publishers, realtime, log"
    )
    assert lines[-1] == "x.yaml:1007:1: (file): 500 more errors follow; mend these first"


def test_a_long_list_of_names_is_cut(tmp_path: Path) -> None:
    axes = "".join(
        f"  - {{name: B{n}, input: {{source: plc1, node: i={n}}}, observer: {{type: aoi, r_x: 1}}}}\n"
        for n in range(99)
    )
    servers = "publishers:\n  - {type: modbus, placements: [{axis: Quite_another, address: 4000}]}\n"

    (line,) = report(written(tmp_path, (GOOD + axes + servers).encode()))

    assert line.endswith(", B17, B18 and 80 more")


def test_aliases_cannot_nest_deeper_than_lists(tmp_path: Path) -> None:
    deep = "[" * 20 + "]" * 20

    lines = report(written(tmp_path, f"{GOOD}a: &a {deep}\nb: {'[' * 20}*a{']' * 20}\n".encode()))

    assert any("*a makes more than 32 levels here" in line for line in lines)


def test_paths_of_certificates_begin_at_the_folder_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    security = '4841", security: {certificate: own/me.der, private_key: /etc/me.pem}}'
    (tmp_path / "plant").mkdir()
    file = written(tmp_path / "plant", GOOD.replace('4841"}', security).encode())
    monkeypatch.chdir(tmp_path)

    for path, folder in ((file, f"{tmp_path}/plant"), ("plant/x.yaml", "plant")):
        found = load(path).sources[0].security  # type: ignore[union-attr]
        assert (found.certificate, found.private_key) == (f"{folder}/own/me.der", "/etc/me.pem")  # type: ignore[union-attr]
