import time
from collections.abc import AsyncIterator, Iterator

import pytest
import pytest_asyncio
from asyncua import Client, ua

from softplc.emulator.plant import Plant
from tests.emulator.scenarios import Emulator, emulator, scenario
from tests.support.network import eventually

# Ramps of an hour: the true position alone tells the step.
PLC = scenario(
    {"name": "AxisX", "motion": {"type": "ramp_hold", "slope": 10.0, "segment_s": 3600.0}},
    {"name": "AxisY", "unit": "deg", "motion": {"type": "ramp_hold", "slope": -5.0, "segment_s": 3600.0}},
    {
        "name": "AxisZ",
        "motion": {"type": "constant", "value": 3.0},
        "faults": [
            {"type": "status", "at_s": 0, "for_s": 3600, "status": "BadSensorFailure"},
            {"type": "freeze", "at_s": 0, "for_s": 3600, "timestamp": "frozen"},
        ],
    },
    opcua={"port": 0},
    modbus={"port": 0},
)


@pytest.fixture(scope="module")
def plc() -> Iterator[Emulator]:
    with emulator(PLC) as running:
        yield running


@pytest_asyncio.fixture
async def client(plc: Emulator) -> AsyncIterator[Client]:
    async with Client(plc.endpoints["opcua"], timeout=30) as connected:
        yield connected


async def read(client: Client, *names: str) -> list[ua.DataValue]:
    """One Read of several nodes."""
    return await client.read_attributes([client.get_node(f"ns=2;s={name}") for name in names])


async def test_one_read_sees_one_step_of_the_plant_and_each_steps_time_is_the_start_plus_whole_periods(
    client: Client,
):
    plant = Plant(PLC)
    seen: set[tuple[int, float]] = set()

    async def one_read() -> None:
        names = [f"{axis}.{name}" for axis in ("AxisX", "AxisY") for name in ("TruePosition", "Position", "Count")]
        values = await read(client, "Heartbeat", *names)
        step = plant.at(round(values[1].Value.Value / 0.5))
        expected = [number for axis in step.axes[:2] for number in (axis.true_position, axis.position, axis.count)]
        assert [value.Value.Value for value in values] == [step.number % 65536, *expected]
        assert len({value.SourceTimestamp for value in values}) == 1
        stamp = values[0].SourceTimestamp
        seen.add((step.number, stamp.timestamp()))

    while len(seen) < 10:
        await one_read()

    first_number, first_stamp = min(seen)
    for number, stamp in seen:
        # 1e-5: a timestamp of today has 2e-7 s of resolution as a float
        assert stamp - first_stamp == pytest.approx((number - first_number) * 0.05, abs=1e-5)


async def test_a_subscription_brings_values_with_the_time_of_their_step(client: Client):
    seen: list[tuple[float, float]] = []

    class Handler:
        def datachange_notification(self, node: object, value: float, data: object) -> None:
            stamp = data.monitored_item.Value.SourceTimestamp  # type: ignore[attr-defined]
            seen.append((value, stamp.timestamp()))

    subscription = await client.create_subscription(20, Handler())
    await subscription.subscribe_data_change(client.get_node("ns=2;s=AxisX.TruePosition"))
    await eventually(lambda: len(seen) >= 5, what="five notifications")
    await subscription.delete()

    (first_value, first_stamp), (last_value, last_stamp) = seen[0], seen[-1]
    assert last_value - first_value == pytest.approx(10.0 * (last_stamp - first_stamp), abs=1e-4)


async def test_bad_measurements_have_no_value_and_a_frozen_sensor_keeps_its_timestamp(client: Client):
    position, count, truth = await read(client, "AxisZ.Position", "AxisZ.Count", "AxisZ.TruePosition")

    assert (position.StatusCode.value, count.StatusCode.value) == (0x808C0000, 0x808C0000)
    assert position.Value.Value is None
    assert truth.Value.Value == 3.0
    assert truth.StatusCode.is_good()
    assert position.SourceTimestamp < truth.SourceTimestamp


async def test_nodes_have_fixed_ids_types_names_and_units(client: Client):
    assert await client.get_namespace_index("urn:softplc:emulator") == 2
    axis = await client.nodes.objects.get_child("2:AxisY")
    variables = {(await node.read_browse_name()).Name: node for node in await axis.get_variables()}

    types = {name: (await node.read_data_type_as_variant_type()).name for name, node in variables.items()}
    assert types == {
        "Position": "Double",
        "TruePosition": "Double",
        "TrueVelocity": "Double",
        "Count": "Int32",
        "Enable": "Boolean",
        "FilteredPosition": "Double",
        "FilteredVelocity": "Double",
    }
    assert {node.nodeid.to_string() for node in variables.values()} == {f"ns=2;s=AxisY.{name}" for name in types}
    unit = await (await variables["TrueVelocity"].get_child("0:EngineeringUnits")).read_value()
    assert (unit.DisplayName.Text, unit.UnitId) == ("deg/s", 0x453936)  # UNECE code E96


@pytest.mark.parametrize(
    ("name", "value", "variant"),
    [
        ("FilteredPosition", 12.25, ua.VariantType.Double),
        ("FilteredVelocity", -1 / 3, ua.VariantType.Double),
        ("Enable", False, ua.VariantType.Boolean),
    ],
)
async def test_an_anonymous_client_writes_what_is_writable(
    client: Client, name: str, value: float, variant: ua.VariantType
):
    node = client.get_node(f"ns=2;s=AxisX.{name}")

    await node.write_value(ua.DataValue(ua.Variant(value, variant)))

    kept = await node.read_data_value()
    assert kept.Value.Value == value
    assert kept.SourceTimestamp is not None  # the client sent none


@pytest.mark.parametrize("name", ["AxisX.Position", "AxisX.TruePosition", "AxisX.TrueVelocity", "Heartbeat"])
async def test_nothing_else_is_writable(client: Client, name: str):
    node = client.get_node(f"ns=2;s={name}")
    variant = ua.VariantType.UInt16 if name == "Heartbeat" else ua.VariantType.Double

    with pytest.raises(ua.UaStatusCodeError) as refused:
        await node.write_value(ua.DataValue(ua.Variant(1, variant)))
    assert refused.value.code in (ua.StatusCodes.BadUserAccessDenied, ua.StatusCodes.BadNotWritable)


async def test_a_value_of_another_type_is_refused(client: Client):
    with pytest.raises(ua.UaStatusCodeError) as refused:
        await client.get_node("ns=2;s=AxisX.Enable").write_value(ua.DataValue(ua.Variant(1.0, ua.VariantType.Double)))
    assert refused.value.code == ua.StatusCodes.BadTypeMismatch


async def test_nobody_becomes_administrator(plc: Emulator):
    client = Client(plc.endpoints["opcua"], timeout=30)
    client.set_user("admin")
    client.set_password("any")

    with pytest.raises(ua.UaError):
        await client.connect()


async def test_both_protocols_write_the_same_memory(plc: Emulator, client: Client):
    from pymodbus.client import AsyncModbusTcpClient

    position, enable = (client.get_node(f"ns=2;s=AxisY.{name}") for name in ("FilteredPosition", "Enable"))
    async with AsyncModbusTcpClient("127.0.0.1", port=plc.port("modbus"), timeout=20) as modbus:
        await modbus.write_registers(128, [0x40A0, 0x0000], device_id=1)
        await modbus.write_coil(1, False, device_id=1)

        deadline = time.monotonic() + 20.0  # it takes a step of the plant, on a machine that may be busy
        while (await position.read_value(), await enable.read_value()) != (5.0, False):
            assert time.monotonic() < deadline

        await position.write_value(-2.0)
        while (await modbus.read_holding_registers(128, count=2, device_id=1)).registers != [0xC000, 0x0000]:
            assert time.monotonic() < deadline
