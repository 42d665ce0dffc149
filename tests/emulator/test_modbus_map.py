import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.emulator import modbus_map
from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import Plant
from tests.emulator.scenarios import scenario

ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")


@pytest.mark.parametrize(
    ("order", "one", "negative"),
    [
        ("ABCD", [0x3F80, 0x0000], [0xC2F6, 0xE979]),
        ("CDAB", [0x0000, 0x3F80], [0xE979, 0xC2F6]),
        ("BADC", [0x803F, 0x0000], [0xF6C2, 0x79E9]),
        ("DCBA", [0x0000, 0x803F], [0x79E9, 0xF6C2]),
    ],
)
def test_floats_are_in_the_byte_order_of_the_scenario(order: str, one: list[int], negative: list[int]):
    assert modbus_map.float_words(1.0, order) == one
    assert modbus_map.float_words(-123.456, order) == negative
    assert modbus_map.float_value(one, order) == 1.0


@given(value=st.floats(width=32, allow_nan=False), order=st.sampled_from(ORDERS))
def test_a_float_that_is_written_is_read_back(value: float, order: str):
    assert modbus_map.float_value(modbus_map.float_words(value, order), order) == value


def test_a_value_beyond_float32_reads_as_infinity_and_nan_as_nan():
    assert modbus_map.float_words(-1e300, "ABCD") == [0xFF80, 0x0000]
    assert math.isnan(modbus_map.float_value(modbus_map.float_words(math.nan, "ABCD"), "ABCD"))


def test_the_registers_of_a_step_are_where_the_map_says():
    chosen = scenario({"name": "AxisX"}, {"name": "AxisY", "motion": {"type": "constant", "value": -4.5}})
    step = Plant(chosen).at(65_536 * 2 + 300)
    memory = MemoryState(2)
    memory.filtered_position[1] = 1.5

    wire = struct.pack(f">{100 + 2 * 20}H", *modbus_map.registers(step, memory, "ABCD"))

    assert struct.unpack_from(">HHIHHff", wire) == (
        300,
        2,
        131_372,
        0x1234,
        0,
        1.0,
        struct.unpack("f", struct.pack("f", -123.456))[0],
    )
    for index, axis in enumerate(step.axes):
        values = struct.unpack_from(">fffiffH", wire, 2 * (100 + 20 * index))
        assert values[:3] == pytest.approx(
            (axis.position, axis.true_position, axis.true_velocity), rel=1e-6
        )  # float32
        assert values[3:] == (axis.count, [0.0, 1.5][index], 0.0, 2)


def test_quality_follows_the_status_of_the_measurement():
    fault = {"type": "status", "at_s": 0, "status": "UncertainSensorNotAccurate"}
    words = modbus_map.registers(Plant(scenario({"name": "A", "faults": [fault]})).at(0), MemoryState(1), "ABCD")

    assert words[112] == 1


def test_only_what_was_written_goes_into_the_memory():
    memory = MemoryState(2)
    memory.filtered_position[1] = 1 / 3  # more than a float32 holds: writing elsewhere must not round it
    words = modbus_map.registers(Plant(scenario({"name": "A"}, {"name": "B"})).at(0), memory, "CDAB")
    words[130:132] = [0x0000, 0x3F80]

    modbus_map.take(words, 130, 2, memory, "CDAB")

    assert memory.filtered_velocity == [0.0, 1.0]
    assert memory.filtered_position == [0.0, 1 / 3]


def test_the_table_names_every_value_that_is_served_once_and_in_both_notations():
    chosen = scenario({"name": "AxisX", "unit": "mm"}, {"name": "AxisY", "unit": "deg"})
    rows = {row.name: row for row in modbus_map.rows(chosen)}

    assert len(rows) == len(modbus_map.rows(chosen)) == 6 + 2 * 8
    assert (rows["AxisY.TrueVelocity"].offset, rows["AxisY.TrueVelocity"].number) == (124, "40125")
    assert rows["AxisY.TrueVelocity"].unit == "deg/s"
    assert {name for name, row in rows.items() if row.writable} == {
        f"{axis}.{name}" for axis in ("AxisX", "AxisY") for name in ("FilteredPosition", "FilteredVelocity", "Enable")
    }
    line = next(line for line in modbus_map.text(chosen).splitlines() if "AxisX.FilteredPosition" in line)
    assert line.split()[:6] == ["holding:108", "40109", "AxisX.FilteredPosition", "float32", "mm", "read/write"]


def test_axes_beyond_the_five_digit_numbers_have_six():
    chosen = scenario(*({"name": f"A{k}"} for k in range(600)))
    last = [row for row in modbus_map.rows(chosen) if row.name == "A599.Position"]

    assert (last[0].offset, last[0].number) == (12_080, "412081")
