"""What clients are told of changes: filters, dead bands, sampling, and everything that is told only once."""

import math
from typing import Any

import pytest
from asyncua import Client, ua

from softplc.publishers.opcua.values import utc
from softplc.sample import StatusCode
from tests.publishers_opcua.conftest import Notifications, Served
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = "ns=2;s=AxisX.Position"


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


async def test_a_modified_item_follows_its_new_filter_and_interval(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    item = await monitor(subscription, client.get_node(POSITION), kind="Absolute", width=100.0, sampling=1000.0)
    await eventually(lambda: len(heard.values) == 1)
    trigger = ua.DataChangeTrigger.StatusValueTimestamp
    parameters = ua.MonitoringParameters(
        ClientHandle=subscription._client_handle,
        SamplingInterval=-1.0,  # as often as published
        Filter=ua.uaprotocol_auto.DataChangeFilter(trigger, ua.DeadbandType.None_, 0.0),
        QueueSize=0,
    )
    request = ua.ModifyMonitoredItemsParameters(
        subscription.subscription_id, ua.TimestampsToReturn.Both, [ua.MonitoredItemModifyRequest(item, parameters)]
    )

    (result,) = await client.uaclient.modify_monitored_items(request)
    calm.exchange.set("AxisX.Position", 1.0)  # a new source timestamp alone
    await calm.scan()

    assert (result.StatusCode.value, result.RevisedQueueSize, result.RevisedSamplingInterval) == (0, 1, 50.0)
    await eventually(lambda: len(heard.values) == 2)
    parameters.Filter.DeadbandType, parameters.Filter.DeadbandValue = ua.DeadbandType.Absolute, -1.0
    (refused,) = await client.uaclient.modify_monitored_items(request)
    assert refused.StatusCode.value == ua.StatusCodes.BadDeadbandFilterInvalid
    await subscription.delete()


@pytest.mark.parametrize(
    ("flt", "expected"),
    [
        (ua.AggregateFilter(), ua.StatusCodes.BadMonitoredItemFilterUnsupported),
        (ua.uaprotocol_auto.DataChangeFilter(1, 7, 0.0), ua.StatusCodes.BadMonitoredItemFilterUnsupported),
        (ua.uaprotocol_auto.DataChangeFilter(1, 1, math.nan), ua.StatusCodes.BadDeadbandFilterInvalid),
        (ua.uaprotocol_auto.DataChangeFilter(1, 1, -1.0), ua.StatusCodes.BadDeadbandFilterInvalid),
    ],
)
async def test_a_filter_that_cannot_be_served_is_refused(
    calm: Served, client: Client, flt: ua.MonitoringFilter, expected: int
) -> None:
    subscription = await client.create_subscription(10, None)
    item = ua.MonitoredItemCreateRequest(ua.ReadValueId(ua.NodeId("AxisX.Position", 2), ua.AttributeIds.Value))
    item.RequestedParameters.Filter = flt
    request = ua.CreateMonitoredItemsParameters(subscription.subscription_id, ItemsToCreate=[item])

    (result,) = await client.uaclient.create_monitored_items(request)

    assert result.StatusCode.value == expected
    await subscription.delete()


async def test_a_monitored_item_that_is_disabled_is_silent_until_it_is_enabled(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    item = await monitor(subscription, client.get_node(POSITION))
    await eventually(lambda: len(heard.values) == 1)

    await subscription.set_monitoring_mode(ua.MonitoringMode.Disabled)
    calm.exchange.set("AxisX.Position", 2.0)
    await calm.scan()
    calm.exchange.set("AxisX.Position", 3.0)
    await calm.scan()
    await subscription.set_monitoring_mode(ua.MonitoringMode.Reporting)
    await eventually(lambda: len(heard.values) == 2)

    assert heard.numbers() == [1.0, 3.0]
    assert item
    await subscription.delete()


async def test_a_subscription_whose_publishing_is_off_is_silent(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await monitor(subscription, client.get_node(POSITION))
    await eventually(lambda: len(heard.values) == 1)

    await subscription.set_publishing_mode(False)
    calm.exchange.set("AxisX.Position", 2.0)
    await calm.scan()
    await subscription.set_publishing_mode(True)
    await eventually(lambda: len(heard.values) == 2)
    await subscription.delete()


async def test_other_attributes_and_events_can_be_monitored(calm: Served, client: Client) -> None:
    heard = Notifications()
    subscription = await client.create_subscription(10, heard)
    await subscription.subscribe_data_change(client.get_node(POSITION), attr=ua.AttributeIds.DisplayName)
    await subscription.subscribe_events(client.nodes.server)
    item = ua.MonitoredItemCreateRequest(ua.ReadValueId(ua.NodeId(2253), ua.AttributeIds.EventNotifier))
    (refused,) = await client.uaclient.create_monitored_items(
        ua.CreateMonitoredItemsParameters(subscription.subscription_id, ItemsToCreate=[item])
    )

    await eventually(lambda: len(heard.values) == 1)
    assert heard.values[0].Value.Value.Text == "Position"
    assert refused.StatusCode.value == ua.StatusCodes.BadEventFilterInvalid
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
