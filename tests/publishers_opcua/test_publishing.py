"""What clients read, against the snapshot: an asyncua client over a real socket."""

import asyncio
import math

import pytest
from asyncua import Client, ua

from softplc.exchange import DEAD_AFTER_AT_LEAST
from softplc.publishers.opcua.values import utc
from softplc.sample import StatusCode
from softplc.tags import DataType
from tests.publishers_opcua.conftest import Notifications, Served, serve
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = "ns=2;s=AxisX.Position"


async def read(client: Client, names: list[str]) -> list[ua.DataValue]:
    """Value attributes with both timestamps, whatever their status."""
    nodes = [ua.ReadValueId(ua.NodeId(name, 2), ua.AttributeIds.Value) for name in names]
    return await client.uaclient.read(ua.ReadParameters(0.0, ua.TimestampsToReturn.Both, nodes))


async def test_every_tag_reads_as_the_snapshot_says(served: Served, client: Client) -> None:
    exchange = served.exchange
    statuses = (StatusCode.GOOD, StatusCode.UNCERTAIN_SUB_NORMAL, StatusCode.BAD_SENSOR_FAILURE, 0x00BA0000)
    for index, tag in enumerate(exchange.table):
        status = statuses[index % len(statuses)]
        number = index % 2 if tag.data_type is DataType.BOOLEAN else index * 1.0
        exchange.set(
            tag.name, math.nan if status & 0x80000000 else number, status, served.clock.utc_ns() - index * 1_000
        )
    await served.scan()

    found = await read(client, [tag.name for tag in exchange.table])

    snapshot = exchange.reader.snapshot()
    for index, tag in enumerate(exchange.table):
        bad = bool(snapshot.statuses[index] & 0x80000000)
        assert (
            tag.name,
            None if bad else snapshot.values[index],
            "Null" if bad else tag.data_type.value,
            snapshot.statuses[index],
            utc(int(snapshot.source_timestamps[index])),
            utc(served.clock.utc_ns()),
        ) == (
            tag.name,
            found[index].Value.Value,
            found[index].Value.VariantType.name,
            found[index].StatusCode.value,
            found[index].SourceTimestamp,
            found[index].ServerTimestamp,
        )


async def test_before_the_first_scan_clients_read_waiting_for_initial_data() -> None:
    async with serve(scanned=False) as served, served.client() as client:
        found = await read(client, [tag.name for tag in served.exchange.table])
        level = await client.get_node(ua.ObjectIds.Server_ServiceLevel).read_value()

        assert {StatusCode.BAD_WAITING_FOR_INITIAL_DATA} == {value.StatusCode.value for value in found}
        assert level < 200  # not Healthy


async def test_a_scan_process_that_stopped_makes_every_tag_bad(calm: Served, client: Client) -> None:
    names = [tag.name for tag in calm.exchange.table]
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await subscription.subscribe_data_change(client.get_node(POSITION))
    await eventually(lambda: heard.numbers() == [1.0])

    calm.clock.advance(DEAD_AFTER_AT_LEAST + 0.1)
    await calm.server.publish()

    assert {StatusCode.BAD_NO_COMMUNICATION} == {value.StatusCode.value for value in await read(client, names)}
    await eventually(lambda: heard.values[-1].StatusCode.value == StatusCode.BAD_NO_COMMUNICATION)
    assert await client.get_node(ua.ObjectIds.Server_ServiceLevel).read_value() < 200
    await calm.scan()
    assert {StatusCode.GOOD} == {value.StatusCode.value for value in await read(client, names)}
    await eventually(lambda: heard.numbers()[-1] == 1.0)
    assert await client.get_node(ua.ObjectIds.Server_ServiceLevel).read_value() == 255
    await subscription.delete()


async def test_server_time_and_status_come_from_softplcs_clock(calm: Served, client: Client) -> None:
    await calm.scan(2.0)

    assert (
        utc(calm.clock.utc_ns()) == await client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime).read_value()
    )
    status = await client.get_node(ua.ObjectIds.Server_ServerStatus).read_value()
    assert (utc(calm.clock.utc_ns()), ua.ServerState.Running) == (status.CurrentTime, status.State)


async def test_who_monitors_the_server_status_hears_every_second(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await subscription.subscribe_data_change(client.get_node(ua.ObjectIds.Server_ServerStatus), queuesize=10)
    await eventually(lambda: len(heard.values) == 1)

    for _ in range(2):
        await calm.scan(1.0)
    await eventually(lambda: len(heard.values) == 3)

    assert heard.numbers()[-1].CurrentTime == utc(calm.clock.utc_ns())
    await subscription.delete()


async def test_publishing_without_clients_notifies_nobody(calm: Served) -> None:
    before = len(asyncio.all_tasks())
    for number in range(5):
        calm.exchange.set("AxisX.Position", float(number))
        await calm.scan()

    assert before >= len(asyncio.all_tasks())
