"""What clients cost: memory that comes back, files that run out, and items by the thousand."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from asyncua import ua

from tests.fuzz.opcua import Host, Neighbour, hosted, patient
from tests.fuzz.opcua_client import RecordedClient

pytestmark = pytest.mark.asyncio(loop_scope="module")

CYCLES = 600
WARM = 200  # cycles after which the places of lost sessions are all taken: from then on nothing is to grow
FEW_FILES = 64


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def host() -> AsyncIterator[Host]:
    async with hosted() as host:
        yield host


async def cycles(host: Host, count: int) -> None:
    """Connect, log in, subscribe; every other client is cut off instead of leaving."""
    for number in range(count):
        client = await RecordedClient.connect(host.port)
        await client.open_channel()
        await client.log_in()
        await client.subscribe()
        if number % 2:
            await client.log_out()
        client.drop()


async def test_memory_does_not_grow_with_the_clients_that_come_and_go(host: Host) -> None:
    await cycles(host, WARM)
    before = (await host.ask())["rss"]

    await cycles(host, CYCLES)

    grown = (await host.ask())["rss"] - before
    assert grown <= 5.0  # MiB; asyncua with its defaults: 29


async def test_twelve_thousand_monitored_items_keep_nobody_from_hearing_of_every_scan(host: Host) -> None:
    async with patient(host) as other, patient(host) as hoarder:
        neighbour = Neighbour()
        subscription = await other.create_subscription(50, neighbour)
        await subscription.subscribe_data_change(other.get_node("ns=2;s=Tasks.main.Heartbeat"), queuesize=100)
        await host.ask()

        many: Any = await hoarder.create_subscription(500, None)
        # a value that rests: this process could not decode 12 000 changes beside the neighbour's
        item = ua.MonitoredItemCreateRequest(ua.ReadValueId(ua.NodeId("AxisX.Position", 2), 13))
        for _ in range(6):
            request = ua.CreateMonitoredItemsParameters(many.subscription_id, ItemsToCreate=[item] * 2000)
            results = await hoarder.uaclient.create_monitored_items(request)
            assert all(result.StatusCode.is_good() for result in results)
        answer = await host.ask()
        beats = len(neighbour.beats)
        async with asyncio.timeout(60):
            while len(neighbour.beats) < beats + 20:
                await asyncio.sleep(0.05)

        assert neighbour.missing() == 0
        assert answer["surprises"] == []


async def test_a_server_short_of_files_keeps_its_clients_and_takes_new_ones() -> None:
    async with hosted(files=FEW_FILES) as host, patient(host) as client:
        flood = [await RecordedClient.connect(host.port) for _ in range(4 * FEW_FILES)]
        assert await client.get_namespace_array()

        async with asyncio.timeout(60):
            while not await gets_in(host):
                pass
        assert await client.get_namespace_array()
        for one in flood:
            one.drop()
        assert host.logged() < 10_000


async def gets_in(host: Host) -> bool:
    """One try of an operator."""
    try:
        client = await RecordedClient.connect(host.port)
        await client.open_channel()
        await client.log_in()
    except (OSError, EOFError):
        return False
    client.drop()
    return True


async def test_five_hundred_sessions_are_served_where_the_limits_allow_them() -> None:
    limits = {"connections": 600, "connections_per_address": 600, "sessions": 600, "sessions_per_address": 600}
    async with hosted(limits) as host:
        before = (await host.ask())["rss"]
        clients = []
        for _ in range(500):
            client = await RecordedClient.connect(host.port)
            await client.open_channel()
            await client.log_in(anonymous=True)
            clients.append(client)

        grown = (await host.ask())["rss"] - before
        assert await gets_in(host)
        for client in clients:
            client.drop()
        assert grown <= 50.0  # MiB: a tenth for each session
