"""A subscription is believed as long as it proves itself by keep-alive, number and state; the newest value counts."""

import asyncio
import signal
import time
from typing import Any

import pytest
from asyncua import ua
from asyncua.server.subscription_service import SubscriptionService

from softplc.clock import SystemClock
from softplc.drivers.opcua.binding import Binding
from softplc.drivers.opcua.driver import REBIND, OpcUaDriver
from softplc.drivers.opcua.node import NodeIdAddress
from softplc.drivers.opcua.witnesses import MOST, Witnesses
from softplc.errors import LinkError
from softplc.tags import Image
from tests.chaos.spoils import WithoutPublishResponses
from tests.drivers_opcua.conftest import StartPlc
from tests.drivers_opcua.opened import ForwardClock, make_driver, opened, read, read_until
from tests.drivers_opcua.servers import AsyncuaPlc, NodePlc
from tests.support.proxy import Mode, Proxy

AXIS = "ns=2;s=PLC.Axis"


async def link_error(driver: OpcUaDriver, count: int = 1) -> LinkError:
    image = Image(count)
    async with asyncio.timeout(20.0):
        while True:
            try:
                await driver.read(image)
            except LinkError as error:
                return error
            await asyncio.sleep(0.01)


def at_the_server(plc: AsyncuaPlc) -> Any:
    """The server's own object of the one subscription that it has."""
    (subscription,) = plc.server.iserver.subscription_service.subscriptions.values()
    return subscription


def moving(plc: AsyncuaPlc, value: float) -> None:
    plc.write("Moving", ua.DataValue(ua.Variant(value, ua.VariantType.Double)))


@pytest.fixture(params=["node-opcua", "asyncua"])
def held(request: pytest.FixtureRequest) -> tuple[str, str]:
    """URL and tag of a value that does not change, at two servers."""
    if request.param == "node-opcua":
        return request.getfixturevalue("plc").url, f"{AXIS}.Float"
    server: AsyncuaPlc = request.getfixturevalue("asyncua_plc")
    return server.url, f"ns={server.index};s=Plain"


async def test_a_value_that_never_changes_stays_good_on_keep_alives_alone(held: tuple[str, str]):
    url, tag = held
    async with opened(url, [tag], mode="subscribe", stale_after_ms=900.0) as driver:
        image = await read(driver, 1)
        arrival = image.arrivals[0]
        until = time.monotonic() + 2.5  # nearly three times the limit
        while time.monotonic() < until:
            await driver.read(image)
            await asyncio.sleep(0.05)

        assert image.statuses[0] == 0
        assert image.arrivals[0] == arrival  # no new evidence, and none is made up


async def test_a_new_timestamp_of_a_value_that_stands_still_is_reported_where_timestamps_count(plc: NodePlc):
    tags = [f"{AXIS}.Held", f"{AXIS}.Count"]
    async with opened(plc.url, tags, mode="subscribe", stamped=[0]) as driver:
        first = await read(driver, 2)
        until = time.monotonic() + 20.0
        image = await read(driver, 2)
        while image.source_timestamps[0] == first.source_timestamps[0]:
            assert time.monotonic() < until
            plc.do("set Count 0")
            plc.do("set Held 3")
            await asyncio.sleep(0.05)
            await driver.read(image)

        assert image.values.tolist() == [3.0, 0.0]
        assert image.source_timestamps[1] == first.source_timestamps[1]


async def test_a_silent_server_has_to_answer_before_its_values_count_again(start_plc: StartPlc):
    plc, patient = start_plc(), {"timeout_ms": 60_000.0, "stale_after_ms": 60_000.0}
    async with opened(plc.url, [f"{AXIS}.Float"], mode="subscribe", **patient) as driver:
        image = await read(driver, 1)
        plc.signal(signal.SIGSTOP)
        async with asyncio.timeout(20.0):  # a scan whose read does not end has stale values
            while (await asyncio.wait({reading := asyncio.create_task(driver.read(image))}, timeout=1.0))[0]:
                await asyncio.sleep(0.01)
        plc.signal(signal.SIGCONT)

        async with asyncio.timeout(20.0):
            await reading
        assert image.statuses[0] == 0


async def test_a_subscription_that_fell_silent_on_a_living_server_is_noticed(asyncua_plc: AsyncuaPlc):
    tag = f"ns={asyncua_plc.index};s=Plain"
    async with opened(asyncua_plc.url, [tag], mode="subscribe", stale_after_ms=600.0) as driver:
        await read(driver, 1)
        asyncua_plc.loop.call_soon_threadsafe(at_the_server(asyncua_plc)._task.cancel)

        assert "no notification and no keep-alive" in str(await link_error(driver))
        async with opened(asyncua_plc.url, [tag]) as another:
            assert (await read(another, 1)).values[0] == 1.5


async def test_a_lost_notification_is_noticed(asyncua_plc: AsyncuaPlc):
    async with opened(asyncua_plc.url, [f"ns={asyncua_plc.index};s=Moving"], mode="subscribe") as driver:
        image = await read(driver, 1)
        moving(asyncua_plc, 1.0)
        await read_until(driver, image, lambda: image.values[0] == 1.0)
        at_the_server(asyncua_plc)._notification_seq += 1
        moving(asyncua_plc, 2.0)

        assert "is missing" in str(await link_error(driver))


async def test_a_subscription_that_the_server_ends_is_noticed(asyncua_plc: AsyncuaPlc, plc: NodePlc):
    async with opened(asyncua_plc.url, [f"ns={asyncua_plc.index};s=Plain"], mode="subscribe") as driver:
        await read(driver, 1)
        service = at_the_server(asyncua_plc).monitored_item_srv
        asyncua_plc.run(service.trigger_statuschange(ua.StatusCode(ua.StatusCodes.BadTimeout)))
        assert "the subscription ended: BadTimeout" in str(await link_error(driver))

    async with opened(plc.url, [f"{AXIS}.Float"], mode="subscribe") as driver:
        await read(driver, 1)
        plc.do("drop")
        assert plc.url in str(await link_error(driver))


async def test_of_samples_in_one_notification_the_newest_wins_and_the_others_are_counted(asyncua_plc: AsyncuaPlc):
    moving(asyncua_plc, 0.0)
    tags = [f"ns={asyncua_plc.index};s=Moving", f"ns={asyncua_plc.index};s=Plain"]
    async with opened(asyncua_plc.url, tags, mode="subscribe", publishing_ms=500.0, sampling_ms=0.0) as driver:
        image = await read(driver, 2)
        asyncua_plc.run(burst(asyncua_plc, 8))
        await read_until(driver, image, lambda: driver.skipped > 0)
        await driver.read(image)

        assert image.values.tolist() == [8.0, 1.5]
        assert driver.skipped == 7


async def burst(plc: AsyncuaPlc, count: int) -> None:
    """Changes in one go: no publishing comes between them."""
    for number in range(1, count + 1):
        value = ua.DataValue(ua.Variant(float(number), ua.VariantType.Double))
        await plc.server.write_attribute_value(ua.NodeId("Moving", plc.index), value)


async def test_a_queue_that_overflowed_shows_in_the_count_and_not_in_the_status(plc: NodePlc):
    settings = {"publishing_ms": 600.0, "sampling_ms": 20.0, "queue_size": 2}
    async with opened(plc.url, [f"{AXIS}.Ramp"], mode="subscribe", **settings) as driver:
        image = await read(driver, 1)
        await read_until(driver, image, lambda: driver.skipped >= 4)

        assert image.statuses[0] == 0


async def test_a_server_that_samples_more_slowly_than_asked_is_remarked_on(plc: NodePlc):
    async with opened(plc.url, [f"{AXIS}.Lazy"], mode="subscribe", sampling_ms=20.0) as driver:
        assert driver.remarks == ("the server samples every 400 ms, 20 ms were asked for",)
    async with opened(plc.url, [f"{AXIS}.Float"], mode="subscribe") as driver:
        assert driver.remarks == ()


async def test_a_slower_server_gets_a_keep_alive_that_fits_or_is_refused(plc: NodePlc):
    """This server publishes every 50 ms at the soonest."""
    hasty = {"mode": "subscribe", "publishing_ms": 1.0}
    async with opened(plc.url, [f"{AXIS}.Float"], **hasty, stale_after_ms=300.0) as driver:
        image = await read(driver, 1)
        until = time.monotonic() + 1.0
        while time.monotonic() < until:
            await driver.read(image)
            await asyncio.sleep(0.02)

    driver = make_driver(plc.url, [f"{AXIS}.Float"], **hasty, stale_after_ms=50.0)
    with pytest.raises(LinkError, match=r"stale_after_ms of \d+ or more \(it is 50\), or mode: poll"):
        await driver.open()


@pytest.mark.parametrize("slowest", [150.0, 300.0, 500.0])
async def test_a_server_that_publishes_far_more_slowly_than_asked_is_subscribed_to_all_the_same(
    asyncua_plc: AsyncuaPlc, monkeypatch: pytest.MonkeyPatch, slowest: float
):
    """This one heeds no ModifySubscription either."""
    create = SubscriptionService.create_subscription

    async def slowly(service: Any, parameters: Any, *more: Any, **named: Any) -> Any:
        parameters.RequestedPublishingInterval = max(slowest, parameters.RequestedPublishingInterval)
        return await create(service, parameters, *more, **named)

    monkeypatch.setattr(SubscriptionService, "create_subscription", slowly)
    tag = f"ns={asyncua_plc.index};s=Moving"
    moving(asyncua_plc, 0.0)
    async with opened(asyncua_plc.url, [tag], mode="subscribe", stale_after_ms=1000.0) as driver:
        image = await read(driver, 1)
        moving(asyncua_plc, slowest)
        await read_until(driver, image, lambda: image.values[0] == slowest)
        assert len(asyncua_plc.server.iserver.subscription_service.subscriptions) == 1


async def test_a_change_that_the_subscription_does_not_report_is_a_lost_link(plc: NodePlc):
    async with Proxy(plc.port) as proxy:
        url = f"opc.tcp://127.0.0.1:{proxy.port}"
        async with opened(url, [f"{AXIS}.Float", f"{AXIS}.Ramp"], mode="subscribe") as driver:
            proxy.spoil = WithoutPublishResponses()
            error = await link_error(driver, 2)  # stale_after_ms is 30 s here
            assert f"{AXIS}.Ramp changed, and the subscription does not report it" in str(error)


async def test_a_subscription_that_reports_slowly_is_not_taken_for_dead(plc: NodePlc):
    tags = [f"{AXIS}.Ramp", f"{AXIS}.NaN", f"{AXIS}.Uncertain"]
    async with opened(plc.url, tags, mode="subscribe", publishing_ms=700.0) as driver:
        image = await read(driver, 3)
        changes = set()
        until = time.monotonic() + 3.0
        while time.monotonic() < until:
            await driver.read(image)
            changes.add(float(image.values[0]))
            await asyncio.sleep(0.02)
        assert len(changes) > 2


async def test_what_was_held_up_on_its_way_is_not_taken_for_current(plc: NodePlc):
    async with Proxy(plc.port) as proxy:
        url = f"opc.tcp://127.0.0.1:{proxy.port}"
        async with opened(url, [f"{AXIS}.Clock"], mode="subscribe") as driver:
            image = await read(driver, 1)
            await proxy.switch(Mode.HOLD)
            stalled = time.time()
            reading = asyncio.create_task(driver.read(image))
            while (await asyncio.wait({reading}, timeout=0.5))[0]:  # until one has to wait for an answer
                reading = asyncio.create_task(driver.read(image))
            await asyncio.sleep(1.5)
            await proxy.switch(Mode.PASS)
            await reading
            made = stalled - (stalled - image.values[0] / 10.0) % 10_000.0  # the value is 10 a second
            assert made + 10_000.0 * (made < stalled - 5_000.0) > stalled + 1.0  # the proof's first answer is older


async def test_of_many_variables_the_last_reported_and_some_others_in_turn_are_witnesses():
    readings = [Binding(NodeIdAddress(2, f"v{n}"), [(n, None)], ua.NodeId(f"v{n}", 2), 0, "") for n in range(100)]
    for binding in readings:
        binding.monitored = True
    latest = Image(100)
    latest.arrivals[:] = range(100)
    session: Any = None  # nothing is asked here
    witnesses = Witnesses(session, readings, latest, SystemClock())
    called = [witnesses.some() for _ in range(10)]
    assert all(set(range(90, 100)) <= set(numbers) and len(numbers) <= MOST for numbers in called)
    assert set().union(*called) == set(range(100))


@pytest.mark.parametrize("part", ["report", "chores"])
async def test_a_defect_where_reports_are_taken_or_in_the_chores_ends_the_connection_not_the_process(
    plc: NodePlc, part: str
):
    clock = ForwardClock()

    async def defect(*_: object) -> None:
        raise ZeroDivisionError

    def raises(*_: object) -> None:
        raise ZeroDivisionError

    async with opened(plc.url, [f"{AXIS}.Ramp"], mode="subscribe", clock=clock) as driver:
        if part == "report":
            driver._subscription._deliver = driver._subscription._take_changes = raises
        else:
            driver._do_chores = defect
            clock.ahead = 2.0 * REBIND  # the next read finds them due
        assert "ZeroDivisionError" in str(await link_error(driver))
