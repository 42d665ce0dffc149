"""What the emulated PLC says about its axes can be typed into a configuration as it stands."""

import json
from pathlib import Path
from urllib.parse import urlsplit

from tests.support.program import Program, softplc

SCENARIO = """\
period_ms: 20
axes:
  - name: AxisX
    motion: {type: constant, value: 5}
    noise: {type: none}
    aoi: {}
  - name: Slide
    motion: {type: bounce, velocity: 100, upper: 200}
opcua: {port: 0}
modbus: {port: 0, byte_order: CDAB}
"""


def test_every_place_that_is_told_reads_good_under_that_name(tmp_path: Path):
    (tmp_path / "scenario.yaml").write_text(SCENARIO, encoding="utf-8")
    with Program("emulate", "scenario.yaml", "--json", cwd=tmp_path) as plc:
        told = plc.ready(90.0)
        transport = {"host": "127.0.0.1", "port": urlsplit(told["modbus"]).port}
        config = {
            "sources": [
                {"name": "opcua", "type": "opcua", "url": told["opcua"]},
                {"name": "modbus", "type": "modbus", "transport": transport, "byte_order": "CDAB"},
            ],
            "axes": [
                {
                    "name": f"{axis}_{name}_{source}",
                    "input": {"source": source, **{key: place[key] for key in keys}},
                    "observer": {"type": "finite_difference"},
                }
                for axis, found in told["axes"].items()
                for name, place in found.items()
                for source, keys in (("opcua", ("node",)), ("modbus", ("address", "data_type")))
            ],
        }
        (tmp_path / "c.yaml").write_text(json.dumps(config), encoding="utf-8")
        done = softplc("check", "c.yaml", "--connect", "--json", cwd=tmp_path, timeout=90.0)

    assert done.returncode == 0, done.stderr + done.stdout
    rows = {row["tag"]: row for row in json.loads(done.stdout)}
    assert len(rows) == 2 * sum(map(len, told["axes"].values())) == 10
    assert {row["status"] for row in rows.values()} == {"Good"}
    assert rows["AxisX_Position_modbus.Raw"]["value"] == rows["AxisX_y_opcua.Raw"]["value"] == 5.0
