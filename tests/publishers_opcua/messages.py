"""An asyncua client that subscribes request by request, so that a test sees each message."""

from typing import Any, Final

from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_from_binary

PARTS: Final = (
    ("1", ["urn:softplc:server"]),
    ("1:2", ["urn:softplc:server", "urn:softplc:tags"]),
    ("1:99", ["urn:softplc:server", "urn:softplc:tags"]),
    ("1:2,0:2", ["urn", "urn"]),
    ("9", ua.StatusCodes.BadIndexRangeNoData),
    ("1,2,3", ua.StatusCodes.BadIndexRangeNoData),
)
"""Index ranges of the NamespaceArray, and what each gives: the part or why there is none."""


class Messages:
    """A session that publishes by hand: one Publish request, one answer."""

    def __init__(self, client: Client, interval: float = 10.0, most: int = 0) -> None:
        self._client, self._interval, self._most = client, interval, most
        self.number = 0
        self.handles = 0

    async def create(self) -> "Messages":
        parameters = ua.CreateSubscriptionParameters(self._interval, 10_000, 3_000, self._most, True, 0)
        answer = await self._ask(ua.CreateSubscriptionRequest(Parameters=parameters), ua.CreateSubscriptionResponse)
        self.number = answer.Parameters.SubscriptionId
        return self

    def use(self, client: Client) -> None:
        """Publish in this client's session, to which the subscription was transferred."""
        self._client = client

    async def _ask(self, request: Any, response: Any) -> Any:
        return struct_from_binary(response, await self._client.uaclient._send_request(request))

    async def create_items(
        self,
        *nodes: ua.NodeId,
        attribute: int = ua.AttributeIds.Value,
        stamps: int = 2,
        queue: int = 10,
        oldest: bool = True,
        flt: Any = None,
        mode: Any = ua.MonitoringMode.Reporting,
        sampling: float = 0.0,
        **other: Any,
    ) -> list[ua.MonitoredItemCreateResult]:
        """Creates items; their handles count on from 0."""
        items = []
        for node in nodes:
            wanted = ua.MonitoringParameters(self.handles, sampling, flt, queue, oldest)
            self.handles += 1
            items.append(ua.MonitoredItemCreateRequest(ua.ReadValueId(node, attribute, **other), mode, wanted))
        found: list[ua.MonitoredItemCreateResult] = await self._client.uaclient.create_monitored_items(
            ua.CreateMonitoredItemsParameters(self.number, ua.TimestampsToReturn(stamps), items)
        )
        return found

    async def monitor(self, *nodes: ua.NodeId, **other: Any) -> list[int]:
        """Ids of items that must be possible."""
        results = await self.create_items(*nodes, **other)
        return [result.MonitoredItemId for result in results if result.StatusCode.check() is None]

    async def modify(
        self,
        item: int,
        handle: int,
        *,
        stamps: int = 2,
        queue: int = 10,
        oldest: bool = True,
        flt: Any = None,
        sampling: float = 0.0,
    ) -> ua.MonitoredItemModifyResult:
        wanted = ua.MonitoringParameters(handle, sampling, flt, queue, oldest)
        (found,) = await self._client.uaclient.modify_monitored_items(
            ua.ModifyMonitoredItemsParameters(
                self.number, ua.TimestampsToReturn(stamps), [ua.MonitoredItemModifyRequest(item, wanted)]
            )
        )
        return found

    async def modify_subscription(
        self, interval: float = 10.0, lifetime: int = 10_000, keep_alive: int = 3_000, most: int = 0
    ) -> ua.ModifySubscriptionResult:
        parameters = ua.ModifySubscriptionParameters(self.number, interval, lifetime, keep_alive, most)
        answer = await self._ask(ua.ModifySubscriptionRequest(Parameters=parameters), ua.ModifySubscriptionResponse)
        found: ua.ModifySubscriptionResult = answer.Parameters
        return found

    async def set_mode(self, mode: Any, *items: int) -> None:
        parameters = ua.SetMonitoringModeParameters(self.number, mode, list(items))
        for status in await self._client.uaclient.set_monitoring_mode(parameters):
            status.check()

    async def publish(self, *acknowledged: int) -> ua.PublishResult:
        acks = [ua.SubscriptionAcknowledgement(self.number, number) for number in acknowledged]
        request = ua.PublishRequest(Parameters=ua.PublishParameters(acks))
        found: ua.PublishResult = (await self._ask(request, ua.PublishResponse)).Parameters
        return found

    async def republish(self, number: int) -> ua.NotificationMessage:
        request = ua.RepublishRequest(Parameters=ua.RepublishParameters(self.number, number))
        found: ua.NotificationMessage = (await self._ask(request, ua.RepublishResponse)).NotificationMessage
        return found

    async def values(self) -> dict[int, ua.DataValue]:
        """The newest DataValue of each handle in the next message."""
        data = (await self.publish()).NotificationMessage.NotificationData
        return {item.ClientHandle: item.Value for each in data for item in each.MonitoredItems}


def told(result: Any) -> list[tuple[int, Any, int]]:
    """Handle, value and status of each notification of a message."""
    return [
        (item.ClientHandle, item.Value.Value.Value, item.Value.StatusCode.value)
        for data in getattr(result, "NotificationMessage", result).NotificationData
        for item in data.MonitoredItems
    ]
