"""softplc beside a PLC that runs the AOI itself: parity on live tags, and tuning from a client."""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua

from tests.emulator.scenarios import Emulator, emulator, scenario
from tests.support.network import free_port
from tests.support.program import Program

TUNING = {"q_x": 0.01, "q_x_dot": 0.1, "r_x": 1.3}


def emulated(name: str, period_s: float, precision: str) -> dict[str, Any]:
    motion = {"type": "sine", "amplitude": 50.0, "period_s": period_s}
    return {"name": name, "motion": motion, "aoi": {"precision": precision, **TUNING}}


PLC = scenario(
    emulated("AxisX", 7.0, "lreal"),
    emulated("AxisY", 9.0, "real"),
    period_ms=250.3,  # slow, so that no sample is missed on a busy machine; and no round number
    opcua={"port": 0},
)
CONFIG = """
tasks:
  - {{name: main, period_ms: 20}}
sources:
  - {{name: plc, type: opcua, url: "{url}", timeout_ms: 5000}}
axes:
{axes}
publishers:
  - type: opcua
    port: {port}
    users:
      - {{name: engineer, password: {{env: TEST_PASSWORD}}}}
"""
AXIS = """
  - name: {name}
    input: {{source: plc, node: "ns=2;s={name}.Position"}}
    enable: {{source: plc, node: "ns=2;s={name}.EnableIn"}}
    dt_source: source
    on_repeat: predict
    observer: {{type: aoi, precision: {precision}, q_x: 0.01, q_x_dot: 0.1, r_x: 1.3}}
    writable_tuning: true
    shadow:
      position: {{source: plc, node: "ns=2;s={name}.y"}}
      velocity: {{source: plc, node: "ns=2;s={name}.y_dot"}}
      dt: {{source: plc, node: "ns=2;s={name}.dt"}}
"""
PASSWORD = "a password of the tests"
SAMPLES = 12  # in a row that must agree in every bit
MAXIMA = ("PositionDeltaMax", "VelocityDeltaMax")


@dataclass
class Plant:
    """The emulated PLC and softplc beside it."""

    plc: Emulator
    program: Program
    url: str


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    with emulator(PLC) as plc:
        axes = [AXIS.format(name=name, precision=kind) for name, kind in (("AxisX", "lreal"), ("AxisY", "real"))]
        text = CONFIG.format(url=plc.endpoints["opcua"], axes="".join(axes), port=free_port())
        path: Path = tmp_path_factory.mktemp("shadow") / "softplc.yaml"
        path.write_text(text, encoding="utf-8")
        with Program("run", str(path), "--json", TEST_PASSWORD=PASSWORD) as program:
            facts = program.ready(120)
            yield Plant(plc, program, facts["endpoints"]["opcua"])


async def read(client: Client, *names: str) -> list[ua.DataValue]:
    """One Read of several nodes."""
    return await client.read_attributes([client.get_node(f"ns=2;s={name}") for name in names])


async def enable(plc: Client, ours: Client, axis: str, state: bool) -> None:
    """The PLC's operator switches its observer; ours follows the PLC's tag."""
    await plc.get_node(f"ns=2;s={axis}.Enable").write_value(ua.Variant(state, ua.VariantType.Boolean))
    while (await read(ours, f"{axis}.Enabled"))[0].Value.Value is not state:
        await asyncio.sleep(0.02)


async def agreeing(ours: Client, axis: str) -> tuple[int, float]:
    """Samples in a row for which the differences were exactly 0, and the largest velocity among them."""
    stamps: set[Any] = set()
    fastest = 0.0
    names = [f"{axis}.{leaf}" for leaf in ("PositionDelta", "VelocityDelta", *MAXIMA, "Velocity")]
    while len(stamps) < SAMPLES:
        values = await read(ours, *names)
        if all(value.StatusCode.is_good() for value in values[:4]):
            if any(value.Value.Value != 0.0 for value in values[:4]):
                break
            stamps.add(values[0].SourceTimestamp)
            fastest = max(fastest, abs(values[4].Value.Value))
        await asyncio.sleep(0.02)
    return len(stamps), fastest


@pytest.mark.parametrize("axis", ["AxisX", "AxisY"])
async def test_beside_a_plc_that_runs_the_aoi_the_difference_is_exactly_nothing(plant: Plant, axis: str):
    """Where a busy machine made us miss a sample, the two begin again together."""
    async with asyncio.timeout(180), Client(plant.plc.endpoints["opcua"]) as plc, Client(plant.url) as ours:
        while True:
            await enable(plc, ours, axis, False)
            await enable(plc, ours, axis, True)
            samples, fastest = await agreeing(ours, axis)
            if samples == SAMPLES:
                break
    assert fastest > 1.0  # the axis moved meanwhile


async def test_tuning_and_reset_from_a_client_are_checked_taken_shown_and_logged(plant: Plant):
    async with asyncio.timeout(120):
        async with Client(plant.url) as nobody:
            node = nobody.get_node("ns=2;s=AxisX.r_x")
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await node.write_value(5.0)
            assert refused.value.code == ua.StatusCodes.BadUserAccessDenied

        client = Client(plant.url)
        client.set_user("engineer")
        client.set_password(PASSWORD)
        async with client:
            node = client.get_node("ns=2;s=AxisX.r_x")
            for value in (0.0, -1.0, float("nan")):
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await node.write_value(value)
                assert refused.value.code == ua.StatusCodes.BadOutOfRange
            assert await node.read_value() == 1.3

            await node.write_value(500.0)
            while await node.read_value() != 500.0:
                await asyncio.sleep(0.02)
            largest = client.get_node("ns=2;s=AxisX.PositionDeltaMax")
            while not (await largest.read_data_value(False)).Value.Value > 0.1:  # the PLC still has the old one
                await asyncio.sleep(0.02)
            await client.get_node("ns=2;s=AxisX.Reset").write_value(True)
            while "tag=AxisX.Reset" not in plain(plant.program.text()):
                await asyncio.sleep(0.02)
            await node.write_value(1.3)
    text = plain(plant.program.text())
    line = next(line for line in text.splitlines() if "tag changed by a client" in line and "AxisX.r_x" in line)
    assert "old=1.3" in line
    assert "new=500.0" in line


def plain(text: str) -> str:
    """A log in key=value form, whichever of its two formats it has."""
    return text.replace('": "', "=").replace('": ', "=").replace('"', "")
