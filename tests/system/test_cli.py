import json

import pytest

from tests.support.network import free_port
from tests.support.program import ROOT, softplc


def test_no_arguments_show_the_commands():
    done = softplc()
    assert done.returncode == 2
    for command in ("demo", "run", "check", "browse", "emulate", "schema", "export", "health"):
        assert command in done.stdout + done.stderr


@pytest.mark.parametrize("command", ["demo", "run", "check", "browse", "emulate", "replay", "schema", "health"])
def test_every_command_explains_itself(command):
    done = softplc(command, "--help")
    assert done.returncode == 0
    assert "Usage" in done.stdout


def test_the_version_is_printed():
    assert softplc("--version").stdout.startswith("softplc 0.")


def test_a_wrong_option_is_a_usage_error():
    done = softplc("check", "--conect", "x.yaml")
    assert done.returncode == 2
    assert "conect" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_configuration_error_names_file_line_and_column_and_exits_78(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text((ROOT / "config" / "minimal.yaml").read_text().replace("r_x", "r_y"))
    done = softplc("check", str(path))
    assert done.returncode == 78
    assert f"{path}:" in done.stderr
    assert "r_x" in done.stderr
    assert done.stdout == ""


def test_a_missing_file_exits_78():
    done = softplc("run", "nowhere.yaml")
    assert done.returncode == 78
    assert "nowhere.yaml" in done.stderr


@pytest.mark.parametrize("name", ["minimal", "demo", "plant"])
def test_the_shipped_examples_are_valid(name):
    done = softplc("check", f"config/{name}.yaml", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)


def test_check_says_what_works_but_not_as_one_would_wish(tmp_path):
    path = tmp_path / "c.yaml"
    bleeding = (
        (ROOT / "config" / "minimal.yaml").read_text().replace("r_x: ", "bleed: {threshold: 1, factor: 0.9}, r_x: ")
    )
    path.write_text(bleeding)
    done = softplc("check", str(path))
    assert done.returncode == 0, done.stderr
    assert "AxisX: bleed also acts on a well-tracked ramp" in " ".join(done.stderr.split())


def test_check_connect_exits_69_and_says_which_source_when_none_answers(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(
        f"""sources:
  - {{name: plc, type: opcua, url: "opc.tcp://127.0.0.1:{free_port()}"}}
axes:
  - name: X
    input: {{source: plc, node: "ns=2;s=X"}}
    observer: {{type: aoi, r_x: 1.0}}
"""
    )
    done = softplc("check", str(path), "--connect")
    assert done.returncode == 69
    assert "plc" in done.stderr
    assert "BadNoCommunication" in done.stdout


def test_browse_exits_69_when_nothing_listens():
    done = softplc("browse", f"opc.tcp://127.0.0.1:{free_port()}")
    assert done.returncode == 69
    assert "Traceback" not in done.stderr


def test_schema_prints_the_shipped_schema():
    done = softplc("schema")
    assert json.loads(done.stdout) == json.loads((ROOT / "config" / "softplc.schema.json").read_text())


def test_health_exits_1_when_nothing_runs(tmp_path):
    path = tmp_path / "c.yaml"
    text = (ROOT / "config" / "demo.yaml").read_text()
    path.write_text(text.replace("5020", str(free_port())).replace("4840", str(free_port())))
    done = softplc("health", str(path), "--timeout", "0.5")
    assert done.returncode == 1


@pytest.mark.parametrize("style", ["csv", "md", "json"])
def test_the_modbus_map_is_exported(style):
    done = softplc("export", "modbus-map", "config/demo.yaml", "--format", style)
    assert done.returncode == 0, done.stderr
    assert "AxisX.Position" in done.stdout


def test_help_imports_none_of_the_heavy_libraries():
    done = softplc("--help", PYTHONPROFILEIMPORTTIME="1")
    for library in ("asyncua", "pymodbus", "numpy"):
        assert f" {library}\n" not in done.stderr


def test_a_table_on_a_pipe_is_never_cut():
    done = softplc("check", "config/plant.yaml")
    assert "nsu=urn:plant:line4;s=Infeed.Position" in done.stdout
    assert done.stdout.splitlines()[0].split()[:4] == ["axis", "task", "period_ms", "source"]


def test_errors_of_a_configuration_are_json_where_json_is_asked_for(tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text("sources: 3\n")
    done = softplc("check", str(path), "--json")
    assert done.returncode == 78
    assert json.loads(done.stdout)["errors"]


def test_a_missing_secret_is_told_by_check_and_names_its_owner():
    done = softplc("check", "config/plant.yaml")
    assert done.returncode == 0
    assert "is not set; it must hold the secret" in done.stderr
    assert "source " in done.stderr


def test_check_connect_without_its_secret_is_a_configuration_error_without_traceback():
    done = softplc("check", "config/plant.yaml", "--connect")
    assert done.returncode == 78
    assert "Traceback" not in done.stderr


def test_browse_says_what_an_endpoint_looks_like():
    done = softplc("browse", "127.0.0.1:4841")
    assert done.returncode == 2
    assert "opc.tcp://127.0.0.1:4841" in done.stderr


def test_an_address_that_is_not_ours_is_not_called_in_use(tmp_path):
    path = tmp_path / "c.yaml"
    text = (ROOT / "config" / "demo.yaml").read_text()
    text = text.replace("4840", str(free_port()))
    path.write_text(text.replace("port: 5020", "port: 5020\n    host: 192.0.2.1"))  # kept for documentation, RFC 5737
    done = softplc("run", str(path))
    assert done.returncode == 1
    assert "in use" not in done.stderr
    assert "192.0.2.1" in done.stderr
