"""The AOI that the emulated PLC runs itself: every step once, with the time that passed, and as its Enable says."""

import struct
from typing import Any

import numpy as np
import pytest
from asyncua import Client, ua

from softplc.emulator import modbus_map
from softplc.emulator.aoi import AoiPrograms
from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import Plant
from softplc.kernel.batch import aoi as batch
from tests.emulator.scenarios import emulator, scenario

TUNING = {"q_x": 0.01, "q_x_dot": 0.1, "r_x": 1.25}


def program(precision: str) -> dict[str, Any]:
    return {"name": "AxisX", "aoi": {"precision": precision, **TUNING}}


@pytest.mark.parametrize(("precision", "dtype"), [("lreal", np.float64), ("real", np.float32)])
def test_the_program_is_the_aoi_also_over_skipped_steps_and_while_it_is_disabled(precision: str, dtype: type):
    chosen = scenario(program(precision), {"name": "AxisY"})
    memory = MemoryState(2)
    programs, plant = AoiPrograms(chosen, memory), Plant(chosen)
    state = batch.AoiBatchState(1, dtype)
    tuning = batch.AoiTuning(
        dtype, **{key: [value] for key, value in TUNING.items()}, BleedEnable=[0], BleedThresh=[0], BleedFactor=[1]
    )
    last = None
    for number in (0, 1, 2, 5, 6, 7, 8, 11, 12, 13):
        memory.enable[0] = number not in (7, 8)
        step = programs.run(plant.at(number))
        dt = 50.0 * (1 if last is None else number - last)
        last = number
        x = np.array([step.axes[0].position])
        enable, rows = np.array([memory.enable[0]]), np.ones(1, np.bool_)
        batch.step(state, tuning, EnableIn=enable, x=x, dt=np.array([dt]), rows=rows)

        shown = step.axes[0].aoi
        assert shown is not None
        assert (shown.enable_in, shown.dt) == (memory.enable[0], dt)
        assert (shown.y, shown.y_dot) == (float(state.y[0]), float(state.y_dot[0]))
        assert step.axes[1].aoi is None


def test_its_outputs_are_in_the_registers_behind_the_quality():
    chosen = scenario(program("real"), {"name": "AxisY"})
    memory = MemoryState(2)
    step = AoiPrograms(chosen, memory).run(Plant(chosen).at(0))
    wire = struct.pack(">140H", *modbus_map.registers(step, memory, "ABCD"))
    shown = step.axes[0].aoi
    assert shown is not None
    assert struct.unpack_from(">fff", wire, 2 * 114) == (50.0, shown.y, shown.y_dot)
    assert wire[2 * 134 : 2 * 140] == bytes(12)
    names = {row.name: row.offset for row in modbus_map.rows(chosen)}
    assert [names[f"AxisX.{name}"] for name in ("dt", "y", "y_dot")] == [114, 116, 118]
    assert "AxisY.y" not in names


@pytest.mark.parametrize(("precision", "variant"), [("lreal", "Double"), ("real", "Float")])
async def test_its_outputs_are_nodes_of_one_step_with_the_measurement(precision: str, variant: str):
    chosen = scenario({**program(precision), "motion": {"type": "constant", "value": 3.0}}, opcua={"port": 0})
    with emulator(chosen) as plc:
        async with Client(plc.endpoints["opcua"], timeout=30) as client:
            names = ("Position", "EnableIn", "dt", "y", "y_dot")
            nodes = [client.get_node(f"ns=2;s=AxisX.{name}") for name in names]
            values = await client.read_attributes(nodes)
            assert values[1].Value.Value is True
            assert values[2].Value.Value >= 50.0
            assert {value.Value.VariantType for value in values[2:]} == {ua.VariantType[variant]}
            assert len({value.SourceTimestamp for value in values}) == 1
            assert abs(values[3].Value.Value - 3.0) < 3.0
