"""Axes that hit their stops, end to end: an emulated PLC, its switches over both protocols, our tags."""

import time
from collections.abc import Iterator

import pytest
from pymodbus.client import ModbusTcpClient

from softplc.publishers.modbus.offsets import AXIS
from tests.support.network import free_port
from tests.support.program import ROOT, Program

AXES = {"Slide": 3000, "Ball": 3064, "Blind": 3128}
_PORTS = ("4841", "5021", "4840", "5020")  # as the shipped files have them; the last two are the defaults


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModbusTcpClient]:
    """A client of our Modbus publisher."""
    folder, ports = tmp_path_factory.mktemp("stops"), {port: str(free_port()) for port in _PORTS}
    for name in ("end_stops_plc.yaml", "end_stops.yaml"):
        text = (ROOT / "config" / name).read_text(encoding="utf-8")
        text = text.replace("type: opcua }\n", "type: opcua, port: 4840 }\n")
        text = text.replace("type: modbus }\n", "type: modbus, port: 5020 }\n")
        for port, free in ports.items():
            text = text.replace(port, free)
        (folder / name).write_text(text, encoding="utf-8")
    with (
        Program("emulate", "end_stops_plc.yaml", "--json", cwd=folder) as plc,
        Program("run", "end_stops.yaml", "--json", cwd=folder) as program,
    ):
        plc.ready(90.0)
        program.ready(90.0)
        client = ModbusTcpClient("127.0.0.1", port=int(ports["5020"]))
        assert client.connect()
        yield client
        client.close()


def value(client: ModbusTcpClient, axis: str, leaf: str) -> float:
    kinds = {"Impacts": (client.DATATYPE.UINT32, 2), "Quality": (client.DATATYPE.UINT16, 1)}
    kind, count = kinds.get(leaf, (client.DATATYPE.FLOAT32, 2))
    reply = client.read_input_registers(AXES[axis] + AXIS.offsets[leaf], count=count, device_id=1)
    assert not reply.isError(), reply
    return float(client.convert_from_registers(reply.registers, kind))  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", AXES)
def test_an_axis_counts_its_impacts_and_is_good(own: ModbusTcpClient, axis: str):
    """By a Boolean node, by a discrete input, and by the position alone."""
    deadline = time.monotonic() + 60.0
    while value(own, axis, "Impacts") < 3.0:
        assert time.monotonic() < deadline, value(own, axis, "Quality")
        time.sleep(0.05)
    while value(own, axis, "Quality") < 2.0:
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_the_slide_never_leaves_its_stops(own: ModbusTcpClient):
    positions = []
    deadline = time.monotonic() + 1.0
    while time.monotonic() < deadline:
        positions.append(value(own, "Slide", "Position"))
    assert -10.0 < min(positions) <= max(positions) < 210.0
