"""An independent client, node-opcua, against softplc's server over a real socket."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio

from softplc.sample import StatusCode
from softplc.tags import DataType
from tests.fuzz.opcua_messages import frames, parse
from tests.publishers_opcua.conftest import PASSWORD, NodeClient, Served, node_client, serve
from tests.support.relay import Relay

pytestmark = pytest.mark.asyncio(loop_scope="module")

VALUE, BROWSE_NAME, DISPLAY_NAME = 13, 3, 4
CLOCK, NAMESPACES = "ns=0;i=2258", "ns=0;i=2255"
GOOD_COMPLETES_ASYNCHRONOUSLY, NOT_WRITABLE, USER_ACCESS_DENIED = 0x002E0000, 0x803B0000, 0x801F0000


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def peer(served: Served, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NodeClient]:
    async with node_client(tmp_path_factory.mktemp("node-opcua")) as client:
        assert "error" not in await client.ask(connect=served.url)
        yield client


async def test_every_tag_reads_as_the_snapshot_says(served: Served, peer: NodeClient) -> None:
    exchange = served.exchange
    statuses = (StatusCode.GOOD, StatusCode.UNCERTAIN_LAST_USABLE_VALUE, StatusCode.BAD_NO_COMMUNICATION, 0x80AB0000)
    for index, tag in enumerate(exchange.table):
        status = statuses[index % len(statuses)]
        value = (
            float("nan") if status & 0x80000000 else float(index % 2 if tag.data_type is DataType.BOOLEAN else index)
        )
        exchange.set(tag.name, value, status, served.clock.utc_ns() - 1_000_000 * index)
    await served.scan()

    answer = await peer.ask(read=[[f"ns=2;s={tag.name}", VALUE] for tag in exchange.table])

    snapshot = exchange.reader.snapshot()
    for index, (tag, sample) in enumerate(zip(exchange.table, answer["samples"], strict=True)):
        bad = bool(snapshot.statuses[index] & 0x80000000)
        assert (
            tag.name,
            None if bad else snapshot.values[index],
            "Null" if bad else tag.data_type.value,
            int(snapshot.statuses[index]),
            snapshot.source_timestamps[index] // 1_000_000,
        ) == (tag.name, sample["value"], sample["dataType"], sample["status"], sample["source"])
    for tag in exchange.table:
        exchange.set(tag.name, 1.0)
    await served.scan()


async def test_our_tags_are_namespace_two(peer: NodeClient, served: Served, tmp_path: Path) -> None:
    async with node_client(tmp_path) as other:
        answer = await other.ask(connect=served.url)

        assert answer["namespaces"] == ["http://opcfoundation.org/UA/", "urn:softplc:server", "urn:softplc:tags"]


async def test_the_browse_path_leads_to_the_tag(peer: NodeClient) -> None:
    answer = await peer.ask(translate=["ObjectsFolder", "/2:softplc/2:Axes/2:AxisX/2:Position"])

    assert answer["targets"] == ["ns=2;s=AxisX.Position"]


async def test_browsing_an_axis_shows_every_tag_of_its_block(served: Served, peer: NodeClient) -> None:
    block = next(block for block in served.exchange.table.blocks if block.name == "AxisX")

    answer = await peer.ask(browse="ns=2;s=AxisX")

    assert [f"ns=2;s={tag.name}" for tag in block.tags] == [found["nodeId"] for found in answer["references"]]
    types = {found["browseName"]: found["type"] for found in answer["references"]}
    assert (types["2:Position"], types["2:K0"], types["2:Reason"]) == ("ns=0;i=17570", "ns=0;i=63", "ns=0;i=2376")


async def test_unit_and_range_are_read_as_the_standard_names_them(peer: NodeClient) -> None:
    answer = await peer.ask(
        read=[["ns=2;s=AxisX.Position.EngineeringUnits", VALUE], ["ns=2;s=AxisX.Position.EURange", VALUE]]
    )

    unit, limits = (sample["value"] for sample in answer["samples"])
    assert (unit["unitId"], unit["displayName"]["text"]) == (5066068, "mm")
    assert (limits["low"], limits["high"]) == (-500.0, 500.0)


async def test_every_change_is_notified_good_to_bad_too(served: Served, peer: NodeClient) -> None:
    name = "ns=2;s=AxisX.Position"
    served.exchange.set("AxisX.Position", 10.0)
    await served.scan()
    await peer.ask(subscribe=[name, "ns=2;s=AxisX.Velocity"], interval=20)

    def seen(status: int, value: float | None) -> bool:
        return any(
            n["notification"] == name and n["status"] == status and n["value"] == value for n in peer.notifications
        )

    await peer.notified(lambda _: seen(StatusCode.GOOD, 10.0))
    served.exchange.set("AxisX.Position", 11.0)
    await served.scan()
    await peer.notified(lambda _: seen(StatusCode.GOOD, 11.0))
    served.exchange.set("AxisX.Position", float("nan"), StatusCode.BAD_NO_COMMUNICATION)
    await served.scan()
    await peer.notified(lambda _: seen(StatusCode.BAD_NO_COMMUNICATION, None))
    served.exchange.set("AxisX.Position", 12.0, StatusCode.UNCERTAIN_INITIAL_VALUE)
    await served.scan()
    await peer.notified(lambda _: seen(StatusCode.UNCERTAIN_INITIAL_VALUE, 12.0))


@pytest.mark.parametrize(("wanted", "then"), [("Source", "Server"), ("Neither", "Both"), ("Both", "Neither")])
async def test_timestamps_are_those_asked_for_whatever_the_node(
    served: Served, peer: NodeClient, wanted: str, then: str
) -> None:
    nodes = [CLOCK, "ns=2;s=AxisY.Position", "ns=2;s=AxisY.Enable"]

    def told(names: str) -> list[bool]:
        """Each node has been notified with these timestamps and no others, the newest time."""
        last = {line["notification"]: line for line in peer.notifications}
        stamps = names in ("Source", "Both"), names in ("Server", "Both")
        return [
            node in last and (last[node]["source"] is not None, last[node]["server"] is not None) == stamps
            for node in nodes
        ]

    peer.notifications.clear()
    await peer.ask(subscribe=nodes, interval=20, timestamps=wanted)
    await peer.notified(lambda _: all(told(wanted)))
    assert "error" not in await peer.ask(modify=CLOCK, timestamps=then)
    for name in ("AxisY.Position", "AxisY.Enable"):
        was = served.exchange.image.values[served.exchange.table.index(name)]
        served.exchange.set(name, float(was == 0.0))
    await served.scan(1.0)

    await peer.notified(lambda _: all(told(then)))
    await peer.ask(unsubscribe=CLOCK)


async def test_part_of_an_array_is_monitored(served: Served, peer: NodeClient) -> None:
    peer.notifications.clear()
    await peer.ask(subscribe=[NAMESPACES], interval=20, range="1:2")

    (found,) = await peer.notified(bool)

    assert found["value"] == ["urn:softplc:server", "urn:softplc:tags"]
    await peer.ask(unsubscribe=NAMESPACES)


async def test_part_of_an_array_is_read(peer: NodeClient) -> None:
    answer = await peer.ask(read=[[NAMESPACES, VALUE, "1:2"], [NAMESPACES, VALUE, "9"], [CLOCK, VALUE, "0"]])

    no_data = 0x80370000
    assert [
        (["urn:softplc:server", "urn:softplc:tags"], 0),
        (None, no_data),
        (None, no_data),
    ] == [(sample["value"], sample["status"]) for sample in answer["samples"]]


async def test_a_subscription_gets_another_publishing_interval(served: Served, peer: NodeClient) -> None:
    peer.notifications.clear()
    await peer.ask(subscribe=["ns=2;s=AxisY.Position"], interval=500)
    await peer.notified(bool)

    answer = await peer.ask(pace="ns=2;s=AxisY.Position", interval=20)
    served.exchange.set("AxisY.Position", 4711.0)
    await served.scan(1.0)  # the item is still sampled every 500 ms

    assert answer == {"answer": answer["answer"], "interval": 20}
    await peer.notified(lambda lines: any(line["value"] == 4711.0 for line in lines))
    held = served.server._server.iserver.subscription_service.subscriptions.values()
    assert 20.0 in [subscription.data.RevisedPublishingInterval for subscription in held]
    await peer.ask(unsubscribe="ns=2;s=AxisY.Position")


async def test_writes_are_refused_to_an_anonymous_client(peer: NodeClient) -> None:
    tries = [
        ("ns=2;s=AxisX.Position", VALUE, "Double", 1.0, NOT_WRITABLE),
        ("ns=2;s=AxisX.Position", DISPLAY_NAME, "LocalizedText", {"text": "mine"}, NOT_WRITABLE),
        ("ns=2;s=AxisY.Enable", VALUE, "Boolean", False, USER_ACCESS_DENIED),
        ("ns=0;i=2267", VALUE, "Byte", 1, NOT_WRITABLE),  # ServiceLevel
        ("ns=0;i=2259", VALUE, "Int32", 4, NOT_WRITABLE),  # ServerStatus.State
    ]
    for node_id, attribute, data_type, value, expected in tries:
        answer = await peer.ask(write=[node_id, attribute, data_type, value])
        assert (node_id, expected) == (node_id, answer.get("status", answer))


async def test_the_configured_user_writes_enable_and_nothing_else(served: Served, tmp_path: Path) -> None:
    async with node_client(tmp_path) as engineer:
        assert "error" not in await engineer.ask(connect=served.url, user="engineer", password=PASSWORD)

        enable = await engineer.ask(write=["ns=2;s=AxisY.Enable", VALUE, "Boolean", False])
        other = await engineer.ask(write=["ns=2;s=AxisX.Enable", VALUE, "Boolean", False])

        assert (enable["status"], other["status"]) == (GOOD_COMPLETES_ASYNCHRONOUSLY, NOT_WRITABLE)
        assert [(served.exchange.table.index("AxisY.Enable"), 0.0)] == served.exchange.writer.commands()


@pytest.mark.parametrize(("user", "password"), [("engineer", "wrong"), ("admin", "admin"), ("nobody", PASSWORD)])
async def test_wrong_credentials_are_refused(served: Served, tmp_path: Path, user: str, password: str) -> None:
    async with node_client(tmp_path) as stranger:
        answer = await stranger.ask(connect=served.url, user=user, password=password)

        assert "BadIdentityTokenRejected" in answer["error"]


async def test_a_client_whose_line_was_cut_hears_of_changes_again(served: Served, tmp_path: Path) -> None:
    async with node_client(tmp_path) as client:
        await resilient(served, client)

        for connection in list(served.server._listener.clients):
            connection.transport.abort()

        served.exchange.set("AxisX.Position", 2.0)
        await served.scan()
        await client.notified(lambda seen: seen[-1]["value"] == 2.0)


async def test_a_client_hears_of_changes_again_after_the_server_has_restarted(tmp_path: Path) -> None:
    async with node_client(tmp_path) as client, Relay(0) as relay:
        async with serve() as first:
            relay.target = first.port
            await resilient(first, client, f"opc.tcp://127.0.0.1:{relay.port}")
            before = len(relay.streams)
        async with serve(port=first.port) as second:
            for number in (2.0, 3.0):
                second.exchange.set("AxisX.Position", number)
                await second.scan()
                await client.notified(lambda seen, number=number: seen[-1]["value"] == number)
            for _ in range(50):  # a client that asks again for ever does so a thousand times a second
                await asyncio.sleep(0.01)
                await second.scan()

        asked = Counter(parse(frame).service for stream in relay.streams[before:] for frame in frames(bytes(stream)))
    assert asked["CreateMonitoredItemsRequest"] == 1
    assert asked["RepublishRequest"] <= 3
    assert asked["TransferSubscriptionsRequest"] <= 3
    assert asked.total() - asked["PublishRequest"] <= 100  # some 15 for each attempt to connect


async def resilient(served: Served, client: NodeClient, url: str | None = None) -> None:
    """A client that tries for ever to reconnect, with one subscription that has heard of the value 1."""
    served.exchange.set("AxisX.Position", 1.0)
    await served.scan()
    assert "error" not in await client.ask(connect=url or served.url, retries=-1)
    await client.ask(subscribe=["ns=2;s=AxisX.Position"], interval=20)
    await client.notified(lambda seen: bool(seen) and seen[-1]["value"] == 1.0)
