"""Encoders that roll over, end to end: registers of an emulated PLC in, our registers out."""

import itertools
import math
import time
from collections.abc import Iterator

import pytest
from pymodbus.client import ModbusTcpClient

from softplc.publishers.modbus.offsets import AXIS
from tests.support.shipped import beside_its_plc

AXES = {"Slide": 3000, "Table": 3064}
WRAPS = 3  # of each direction


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModbusTcpClient]:
    """A client of our Modbus publisher."""
    with beside_its_plc(tmp_path_factory.mktemp("signal"), "signal") as client:
        yield client


def seen(client: ModbusTcpClient, axis: str) -> tuple[float, float, float, bool]:
    """Position, velocity, what was read, and whether they are Good; of one scan."""
    reply = client.read_input_registers(AXES[axis], count=50, device_id=1)
    assert not reply.isError(), reply

    def number(leaf: str) -> float:
        at = AXIS.offsets[leaf]
        return float(client.convert_from_registers(reply.registers[at : at + 2], client.DATATYPE.FLOAT32))  # type: ignore[arg-type]

    return number("Position"), number("Velocity"), number("Raw"), reply.registers[AXIS.offsets["Quality"]] == 2


@pytest.mark.parametrize(
    ("axis", "span", "fastest", "turn"), [("Slide", 65.536, 250.0, math.inf), ("Table", 360.0, 720.0, 360.0)]
)
def test_an_encoder_that_rolls_over_both_ways_makes_no_spike(
    own: ModbusTcpClient, axis: str, span: float, fastest: float, turn: float
):
    """A rollover taken for motion would double the velocity, and the position would jump by a span."""
    up = down = 0
    before: tuple[float, float, float] | None = None
    places: list[float] = []
    deadline = time.monotonic() + 90.0
    while up < WRAPS or down < WRAPS:
        assert time.monotonic() < deadline, (up, down)
        position, velocity, raw, good = seen(own, axis)
        if not good:  # at the start, or when this machine kept the PLC waiting
            before = None
            continue
        # The AOI overshoots by a fifth where the axis stops, more where the PLC was late; a rollover would double it.
        assert abs(velocity) < 1.6 * fastest
        at = time.monotonic()
        if before is not None and at - before[2] < 0.2 * span / fastest:
            moved = math.remainder(position - before[0], turn) if turn < math.inf else position - before[0]
            assert abs(moved) < span / 2.0  # nor has the position a jump
            up += raw - before[1] < -span / 2.0
            down += raw - before[1] > span / 2.0
        before = position, raw, at
        places.append(position)
    if axis == "Slide":
        assert max(places) - min(places) > 2.0 * span  # the position is beyond the counter's range
        assert max(abs(here - there) for here, there in itertools.pairwise(places)) < span
    else:
        assert 0.0 <= min(places) < 30.0
        assert 330.0 < max(places) <= 360.0  # a float32 just below 360 may be 360
