"""What clients read and are told, against the snapshot: an asyncua client over a real socket."""

import asyncio
import math
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua

from softplc.exchange import DEAD_AFTER_AT_LEAST
from softplc.publishers.opcua.values import utc
from softplc.sample import StatusCode
from softplc.tags import DataType
from tests.publishers_opcua.conftest import Served, serve
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = "ns=2;s=AxisX.Position"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(served: Served) -> AsyncIterator[Client]:
    async with served.client() as client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def calm(served: Served) -> Served:
    """Every tag Good and 1, published."""
    for tag in served.exchange.table:
        served.exchange.set(tag.name, 1.0)
    await served.scan()
    return served


class Notifications:
    """Collects the DataValues of data changes."""

    def __init__(self) -> None:
        self.values: list[ua.DataValue] = []

    def datachange_notification(self, _node: Any, _value: Any, data: Any) -> None:
        self.values.append(data.monitored_item.Value)

    def numbers(self) -> list[Any]:
        return [value.Value.Value for value in self.values]


async def read(client: Client, names: list[str]) -> list[ua.DataValue]:
    """Value attributes, whatever their status."""
    return await client.uaclient.read_attributes([ua.NodeId(name, 2) for name in names], ua.AttributeIds.Value)


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


async def test_each_change_is_notified_once_with_status_and_time(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await subscription.subscribe_data_change(client.get_node(POSITION), queuesize=10)
    await eventually(lambda: len(heard.values) == 1)
    expected = []
    for number, status in (
        (2.0, StatusCode.GOOD),
        (2.0, StatusCode.UNCERTAIN_LAST_USABLE_VALUE),
        (math.nan, StatusCode.BAD_NO_COMMUNICATION),
        (math.nan, StatusCode.BAD_TIMEOUT),
        (3.0, StatusCode.GOOD),
    ):
        calm.exchange.set("AxisX.Position", number, status)
        expected.append((None if math.isnan(number) else number, int(status), utc(calm.clock.utc_ns())))
        await calm.scan()
        await calm.scan()  # nothing changed: nothing is told

    await eventually(lambda: len(heard.values) == 1 + len(expected))

    assert expected == [(v.Value.Value, v.StatusCode.value, v.SourceTimestamp) for v in heard.values[1:]]
    await subscription.delete()


async def test_new_timestamps_alone_are_told_only_to_who_asks_for_them(calm: Served, client: Client) -> None:
    plain, stamped = Notifications(), Notifications()
    node = client.get_node(POSITION)
    first = await client.create_subscription(10, plain)
    await first.subscribe_data_change(node, queuesize=10)
    second = await client.create_subscription(10, stamped)
    await monitor(second, node, trigger="StatusValueTimestamp")
    await eventually(lambda: len(plain.values) == len(stamped.values) == 1)

    for _ in range(3):
        calm.exchange.set("AxisX.Position", 1.0)
        await calm.scan()
    await eventually(lambda: len(stamped.values) == 4)

    assert len(plain.values) == 1
    await first.delete()
    await second.delete()


async def monitor(
    subscription: Any,
    node: Any,
    *,
    trigger: str = "StatusValue",
    kind: str = "None_",
    width: float = 0.0,
    sampling: float = 0.0,
) -> Any:
    """One monitored item with a filter; returns its id, or the status when it is Bad."""
    request = subscription._make_monitored_item_request(
        node,
        ua.AttributeIds.Value,
        ua.uaprotocol_auto.DataChangeFilter(
            getattr(ua.DataChangeTrigger, trigger), getattr(ua.DeadbandType, kind), width
        ),
        10,
        ua.MonitoringMode.Reporting,
        sampling,
    )
    (found,) = await subscription.create_monitored_items([request])
    return found


async def test_a_slow_tag_moves_under_an_absolute_dead_band(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await monitor(subscription, client.get_node(POSITION), kind="Absolute", width=1.0)
    await eventually(lambda: len(heard.values) == 1)

    for step in range(1, 9):
        calm.exchange.set("AxisX.Position", 1.0 + 0.4 * step)
        await calm.scan()
    calm.exchange.set("AxisX.Position", math.nan, StatusCode.BAD_NO_COMMUNICATION)
    await calm.scan()
    await eventually(lambda: len(heard.values) == 4)

    assert [1.0, pytest.approx(2.2), pytest.approx(3.4), None] == heard.numbers()
    await subscription.delete()


async def test_a_dead_band_in_percent_is_of_the_range(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await monitor(subscription, client.get_node(POSITION), kind="Percent", width=1.0)  # 1 % of 1000 mm
    await eventually(lambda: len(heard.values) == 1)

    for number in (10.9, 11.1):
        calm.exchange.set("AxisX.Position", number)
        await calm.scan()
    await eventually(lambda: len(heard.values) == 2)

    assert heard.numbers() == [1.0, 11.1]
    refused = await monitor(subscription, client.get_node("ns=2;s=AxisX.NIS"), kind="Percent", width=1.0)
    assert ua.StatusCodes.BadFilterNotAllowed == refused.value
    await subscription.delete()


async def test_a_slower_sampling_interval_gets_every_nth_value_and_the_last(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await monitor(subscription, client.get_node(POSITION), sampling=200.0)
    await eventually(lambda: len(heard.values) == 1)

    for number in range(2, 12):
        calm.exchange.set("AxisX.Position", float(number))
        await calm.scan(0.05)
    for _ in range(5):  # the value rests; what came last must still be told
        await calm.scan(0.05)
    await eventually(lambda: heard.numbers()[-1] == 11.0)

    assert heard.numbers() == [1.0, 5.0, 9.0, 11.0]  # every fourth scan of 50 ms
    await subscription.delete()


async def test_a_client_that_monitors_all_tags_hears_all_changes(calm: Served, client: Client) -> None:
    heard = Notifications()
    nodes = [client.get_node(f"ns=2;s={tag.name}") for tag in calm.exchange.table]
    subscription = await client.create_subscription(10, heard)
    await subscription.subscribe_data_change(nodes)
    await eventually(lambda: len(heard.values) == len(nodes))

    for tag in calm.exchange.table:
        calm.exchange.set(tag.name, 0.0)
    await calm.scan()

    await eventually(lambda: len(heard.values) == 2 * len(nodes))
    await subscription.delete()
    assert not calm.server._watch._watched.any()


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
