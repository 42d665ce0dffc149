"""Axes that hit their stops, end to end: an emulated PLC, its switches over both protocols, our tags."""

import time
from collections.abc import Iterator

import pytest
from pymodbus.client import ModbusTcpClient

from softplc.publishers.modbus.offsets import AXIS
from tests.support.shipped import beside_its_plc

AXES = {"Slide": 3000, "Ball": 3064, "Blind": 3128}


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModbusTcpClient]:
    """A client of our Modbus publisher."""
    with beside_its_plc(tmp_path_factory.mktemp("stops"), "end_stops") as client:
        yield client


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
