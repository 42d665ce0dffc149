"""A configuration of config/ beside the emulated PLC that belongs to it, both as commands on ports of their own."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pymodbus.client import ModbusTcpClient

from tests.support.network import free_port
from tests.support.program import ROOT, Program

_PORTS = ("4841", "5021", "4840", "5020")  # as the shipped files have them; the last two are the defaults


@contextmanager
def beside_its_plc(folder: Path, name: str) -> Iterator[ModbusTcpClient]:
    """`softplc run NAME.yaml` beside `softplc emulate NAME_plc.yaml`; gives a client of our Modbus publisher."""
    ports = {port: str(free_port()) for port in _PORTS}
    plant, own = f"{name}_plc.yaml", f"{name}.yaml"
    for file in (plant, own):
        text = (ROOT / "config" / file).read_text(encoding="utf-8")
        text = text.replace("type: opcua }\n", "type: opcua, port: 4840 }\n")
        text = text.replace("type: modbus }\n", "type: modbus, port: 5020 }\n")
        for port, free in ports.items():
            text = text.replace(port, free)
        (folder / file).write_text(text, encoding="utf-8")
    with (
        Program("emulate", plant, "--json", cwd=folder) as plc,
        Program("run", own, "--json", cwd=folder) as program,
    ):
        plc.ready(90.0)
        program.ready(90.0)
        client = ModbusTcpClient("127.0.0.1", port=int(ports["5020"]))
        assert client.connect()
        yield client
        client.close()
