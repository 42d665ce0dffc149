"""Subscriptions, requests and browsing within their bounds, each session with its own."""

import gc
import logging
from typing import Any

import pytest
from asyncua import Client, ua

from tests.publishers_opcua.conftest import LIMITS, Served, refused

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes
POSITION = ua.NodeId("AxisX.Position", 2)


async def subscribed(client: Client, count: int = 1) -> Any:
    subscription = await client.create_subscription(20, None)
    await subscription.subscribe_data_change([client.get_node(POSITION)] * count)
    return subscription


async def republish(client: Client, subscription_id: int, sequence_number: int) -> int:
    parameters = ua.RepublishParameters(subscription_id, sequence_number)
    with pytest.raises(ua.UaStatusCodeError) as error:
        await client.uaclient._send_request(ua.RepublishRequest(Parameters=parameters))
    return refused(error)


async def test_republish_says_what_is_not_there(quiet: Served) -> None:
    async with quiet.client() as client:
        subscription = await subscribed(client)

        assert CODES.BadSubscriptionIdInvalid == await republish(client, 1, 1)
        assert CODES.BadMessageNotAvailable == await republish(client, subscription.subscription_id, 4711)


def loggers() -> int:
    gc.collect()
    return sum(issubclass(type(found), logging.Logger) for found in gc.get_objects())  # a dead proxy has no __class__


async def test_a_subscription_that_is_gone_leaves_no_logger_behind(quiet: Served) -> None:
    async with quiet.client() as client:
        before = loggers()
        for _ in range(10):
            await (await subscribed(client)).delete()

        assert loggers() <= before  # those of earlier connections may go meanwhile


async def test_a_session_cannot_touch_anothers_subscription(quiet: Served) -> None:
    async with quiet.client() as owner, quiet.client() as stranger:
        subscription = await subscribed(owner)
        number = subscription.subscription_id
        service = stranger.uaclient

        (deleted,) = await service.delete_subscriptions([number])
        (moded,) = await service.set_publishing_mode(ua.SetPublishingModeParameters(False, [number]))
        transferred = await service._send_request(
            ua.TransferSubscriptionsRequest(Parameters=ua.TransferSubscriptionsParameters([number], True))
        )
        assert CODES.BadSubscriptionIdInvalid == deleted.value == moded.value
        assert transferred is not None
        for request in (
            service.modify_subscription(ua.ModifySubscriptionParameters(number, 10)),
            service.create_monitored_items(
                ua.CreateMonitoredItemsParameters(number, ItemsToCreate=[ua.MonitoredItemCreateRequest()])
            ),
            service.delete_monitored_items(ua.DeleteMonitoredItemsParameters(number, [112])),
            service.modify_monitored_items(ua.ModifyMonitoredItemsParameters(number)),
        ):
            with pytest.raises(ua.UaStatusCodeError) as error:
                await request
            assert CODES.BadSubscriptionIdInvalid == refused(error)
        assert CODES.BadSubscriptionIdInvalid == await republish(stranger, number, 1)

        subscriptions = quiet.server._server.iserver.subscription_service.subscriptions
        assert (subscriptions[number]._publishing_enabled, len(subscriptions[number].monitored_item_srv)) == (True, 1)


async def test_subscriptions_and_items_of_one_session_are_limited(quiet: Served) -> None:
    async with quiet.client() as client:
        with pytest.raises(ua.UaStatusCodeError) as items:
            await subscribed(client, LIMITS.items_per_session + 1)
        for _ in range(LIMITS.subscriptions_per_session - 1):
            await client.create_subscription(20, None)
        with pytest.raises(ua.UaStatusCodeError) as subscriptions:
            await client.create_subscription(20, None)

        assert (CODES.BadTooManyMonitoredItems, CODES.BadTooManySubscriptions) == (
            refused(items),
            refused(subscriptions),
        )
        async with quiet.client() as other:
            await subscribed(other)


async def test_a_request_for_too_many_nodes_is_refused_and_the_limit_is_told(quiet: Served) -> None:
    async with quiet.client() as client:
        told = ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead
        assert LIMITS.operations == await client.get_node(told).read_value()
        for count, expected in ((LIMITS.operations + 1, CODES.BadTooManyOperations), (0, CODES.BadNothingToDo)):
            with pytest.raises(ua.UaStatusCodeError) as error:
                await client.uaclient.read_attributes([POSITION] * count, ua.AttributeIds.Value)
            assert expected == refused(error)


def browse_request(node: str, page: int, count: int = 1) -> ua.BrowseParameters:
    description = ua.BrowseDescription(ua.NodeId(node, 2), ua.BrowseDirection.Forward, ua.NodeId(33), True, 0, 63)
    return ua.BrowseParameters(RequestedMaxReferencesPerNode=page, NodesToBrowse=[description] * count)


async def test_a_wide_node_is_browsed_in_pages(quiet: Served) -> None:
    async with quiet.client() as client:
        (whole,) = await client.uaclient.browse(browse_request("AxisX", 0))
        (part,) = await client.uaclient.browse(browse_request("AxisX", 10))
        pages = [part.References]
        while part.ContinuationPoint:
            (part,) = await client.uaclient.browse_next(ua.BrowseNextParameters(False, [part.ContinuationPoint]))
            pages.append(part.References)

        assert [len(page) for page in pages] == [10, 10, 10, 6]
        assert whole.References == [reference for page in pages for reference in page]


async def test_continuation_points_end_and_are_limited(quiet: Served) -> None:
    async with quiet.client() as client:
        results = await client.uaclient.browse(browse_request("AxisX", 1, LIMITS.continuation_points + 1))
        points = [result.ContinuationPoint for result in results[:-1]]
        assert CODES.BadNoContinuationPoints == results[-1].StatusCode.value

        released = await client.uaclient.browse_next(ua.BrowseNextParameters(True, points))
        again = await client.uaclient.browse_next(ua.BrowseNextParameters(False, points[:1]))

        assert {CODES.Good} == {result.StatusCode.value for result in released}
        assert [CODES.BadContinuationPointInvalid] == [result.StatusCode.value for result in again]


async def test_one_browse_request_looks_at_a_bounded_number_of_references(quiet: Served) -> None:
    async with quiet.client() as client:
        results = await client.uaclient.browse(browse_request("AxisX", 0, 20))

        statuses = [result.StatusCode.value for result in results]
        assert CODES.Good == statuses[0]
        assert CODES.BadNoContinuationPoints == statuses[-1]


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("NodeId", ua.NodeId("AxisZ", 2), CODES.BadNodeIdUnknown),
        ("ReferenceTypeId", ua.NodeId("AxisX", 2), CODES.BadReferenceTypeIdInvalid),
        ("ReferenceTypeId", ua.NodeId(99_999), CODES.BadReferenceTypeIdInvalid),
    ],
)
async def test_a_browse_that_makes_no_sense_is_told(quiet: Served, field: str, value: Any, expected: int) -> None:
    async with quiet.client() as client:
        request = browse_request("AxisX", 0)
        setattr(request.NodesToBrowse[0], field, value)

        (result,) = await client.uaclient.browse(request)

        assert expected == result.StatusCode.value


async def test_a_modified_item_that_does_not_exist_is_told(quiet: Served) -> None:
    async with quiet.client() as client:
        subscription = await subscribed(client)
        request = ua.ModifyMonitoredItemsParameters(subscription.subscription_id)
        request.ItemsToModify = [ua.MonitoredItemModifyRequest(MonitoredItemId=4711)]

        (result,) = await client.uaclient.modify_monitored_items(request)

        assert CODES.BadMonitoredItemIdInvalid == result.StatusCode.value


@pytest.mark.parametrize("interval", [0.0, -5.0, float("nan"), float("inf"), 1e-300])
async def test_an_absurd_publishing_interval_is_revised(quiet: Served, interval: float) -> None:
    async with quiet.client() as client:
        parameters = ua.CreateSubscriptionParameters(interval, 0, 0, 0, True, 0)

        result = await client.uaclient.create_subscription(parameters, lambda _: None)

        assert LIMITS.min_publishing_ms <= result.RevisedPublishingInterval <= LIMITS.max_publishing_ms
        assert result.RevisedLifetimeCount >= 3 * result.RevisedMaxKeepAliveCount
