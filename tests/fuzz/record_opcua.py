"""Record what asyncua's and node-opcua's clients say to the server: python -m tests.fuzz.record_opcua

Writes the corpus anew. Messages that differ in nothing but their request header are kept once.
"""

import asyncio
import contextlib
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

from asyncua import Client, ua

from tests.fuzz.opcua_messages import CORPUS, SUBSCRIPTION, TOKEN, frames, parse
from tests.publishers_opcua.conftest import PASSWORD, Served, node_client, serve
from tests.support.relay import Relay

POSITION = ua.NodeId("AxisX.Position", 2)
ENABLE = ua.NodeId("AxisY.Enable", 2)


class Tap:
    """A relay before the server, and what of its streams must be made a placeholder."""

    def __init__(self, served: Served, relay: Relay) -> None:
        self.url = f"opc.tcp://127.0.0.1:{relay.port}"
        self._relay = relay
        self._inner: Any = served.server._server.iserver
        self._tokens: set[bytes] = set()
        self._subscriptions: set[int] = set()
        self._inner.subscription_service._sub_id_counter = 0x5EED5EED  # no other number of a message is that

    async def look(self) -> None:
        """Note every session and subscription that there is, for ever."""
        while True:
            self._tokens |= {session.auth_token.Identifier for session in self._inner._external_sessions.values()}
            self._subscriptions |= set(self._inner.subscription_service.subscriptions)
            await asyncio.sleep(0)

    def save(self, name: str) -> None:
        lines, seen = [], set()
        for stream in self._relay.streams:
            whole = bytes(stream)
            for token in self._tokens:
                whole = whole.replace(token, TOKEN)
            for number in self._subscriptions:
                whole = whole.replace(number.to_bytes(4, "little"), SUBSCRIPTION)
            for part in frames(whole):
                message = parse(part)
                key = (message.service, message.body[message.payload :])
                if message.kind != b"CLO" and key not in seen:
                    seen.add(key)
                    lines.append(f"{message.service} {part.hex()}\n")
        (CORPUS / f"{name}.txt").write_text("".join(lines))


async def asyncua_talks(url: str) -> None:
    """Every service that asyncua's client knows."""
    engineer = Client(url, timeout=20)
    engineer.set_user("engineer")
    engineer.set_password(PASSWORD)
    async with engineer as client:
        await _reads(client)
        await _subscribes(client)
        service = client.uaclient
        await service.find_servers(ua.FindServersParameters())
        for request in (
            ua.RegisterServerRequest(Server=ua.RegisteredServer(ServerUri="urn:x", DiscoveryUrls=["opc.tcp://x"])),
            ua.AddNodesRequest(),
            ua.DeleteNodesRequest(),
            ua.HistoryUpdateRequest(),
        ):
            with contextlib.suppress(ua.UaError):
                await service._send_request(request)
    async with Client(url, timeout=20) as anonymous:
        await anonymous.get_namespace_array()


async def _reads(client: Client) -> None:
    service = client.uaclient
    node = client.get_node(POSITION)
    await client.get_endpoints()
    await node.read_data_value()
    await node.read_attributes(list(ua.AttributeIds)[:20])
    await client.get_node("ns=2;s=AxisX.Position.EURange").read_value()
    await client.nodes.objects.get_children()
    await client.nodes.objects.get_child(["2:softplc", "2:Axes", "2:AxisX"])
    description = ua.BrowseDescription(ua.NodeId("AxisX", 2), ua.BrowseDirection.Forward, ua.NodeId(33), True, 0, 63)
    (page,) = await service.browse(ua.BrowseParameters(RequestedMaxReferencesPerNode=3, NodesToBrowse=[description]))
    await service.browse_next(ua.BrowseNextParameters(False, [page.ContinuationPoint]))
    await service.register_nodes([POSITION])
    await service.unregister_nodes([POSITION])
    for value in (False, 1.5, "text", [1, 2, 3], ua.Range(0, 1), [ua.LocalizedText("x")], ua.Variant(1.5)):
        with contextlib.suppress(ua.UaError):
            await client.get_node(ENABLE).write_value(value)
    with contextlib.suppress(ua.UaError):
        await client.nodes.server.call_method(ua.NodeId(11492), 1)
    with contextlib.suppress(ua.UaError):
        await node.read_raw_history(numvalues=3)


async def _subscribes(client: Client) -> None:
    service = client.uaclient
    subscription: Any = await client.create_subscription(20, Silent())
    number = subscription.subscription_id
    node = client.get_node(POSITION)
    banded = ua.uaprotocol_auto.DataChangeFilter(
        ua.DataChangeTrigger.StatusValueTimestamp, ua.DeadbandType.Absolute, 1
    )
    (item,) = await subscription.create_monitored_items(
        [subscription._make_monitored_item_request(node, ua.AttributeIds.Value, banded, 10,
                                                   ua.MonitoringMode.Reporting, 50.0)]
    )  # fmt: skip
    await subscription.subscribe_data_change([node, client.get_node(ENABLE)])
    await subscription.subscribe_events(client.nodes.server)
    await subscription.modify_monitored_item(item, 100.0, 5, mod_filter_val=2)
    await subscription.set_monitoring_mode(ua.MonitoringMode.Sampling)
    await subscription.set_publishing_mode(False)
    await subscription.set_publishing_mode(True)
    await service.modify_subscription(ua.ModifySubscriptionParameters(number, 100, 30, 10, 0, 0))
    for request in (
        ua.RepublishRequest(Parameters=ua.RepublishParameters(number, 1)),
        ua.TransferSubscriptionsRequest(Parameters=ua.TransferSubscriptionsParameters([number], True)),
    ):
        with contextlib.suppress(ua.UaError):
            await service._send_request(request)
    await asyncio.sleep(0.3)
    await subscription.unsubscribe(item)
    await subscription.delete()


class Silent:
    def datachange_notification(self, _node: Any, _value: Any, _data: Any) -> None:
        """Not interested."""

    def event_notification(self, _event: Any) -> None:
        """Not interested."""


async def node_opcua_talks(folder: Path, url: str) -> None:
    """What node-opcua's client does for tests/peers/opcua_client.js."""
    async with node_client(folder) as client:
        await client.ask(connect=url, user="engineer", password=PASSWORD)
        await client.ask(read=[["ns=2;s=AxisX.Position", 13], ["ns=2;s=AxisX.Position.EURange", 13]])
        await client.ask(browse="ns=2;s=AxisX")
        await client.ask(translate=["ObjectsFolder", "/2:softplc/2:Axes/2:AxisX/2:Position"])
        await client.ask(write=["ns=2;s=AxisY.Enable", 13, "Boolean", False])
        await client.ask(write=["ns=2;s=AxisX.Position", 13, "Double", 1.0])
        await client.ask(subscribe=["ns=2;s=AxisX.Position", "ns=2;s=AxisX.Velocity"], interval=20)
        await client.notified(lambda seen: len(seen) >= 2)
        await client.ask(disconnect=True)


async def main() -> None:
    CORPUS.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, talk in (("asyncua", asyncua_talks), ("node-opcua", partial(node_opcua_talks, Path(folder)))):
            async with serve() as served, Relay(served.port) as relay:
                tap = Tap(served, relay)
                looking = asyncio.create_task(tap.look())
                await talk(tap.url)
                looking.cancel()
                tap.save(name)


if __name__ == "__main__":
    asyncio.run(main())
