"""The sampling interval that is told is the one that is kept, with the fast path and without."""

import pytest
from asyncua import Client, ua

from tests.publishers_opcua.conftest import Served
from tests.publishers_opcua.messages import Messages, told

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = ua.NodeId("AxisX.Position", 2)
PUBLISH = 50.0  # ms, the period of the scans
SCANS = 60
ASKED = (
    (0.0, 50.0), (1.0, 50.0), (50.0, 50.0), (60.0, 50.0), (70.0, 50.0), (74.0, 50.0), (76.0, 100.0), (99.0, 100.0),
    (120.0, 100.0), (130.0, 150.0), (170.0, 150.0), (240.0, 250.0), (1000.0, 1000.0),
)  # fmt: skip


@pytest.mark.parametrize("modified", [False, True], ids=["created", "modified"])
@pytest.mark.parametrize("late", [0.0, 0.01, -0.01], ids=["on time", "late", "early"])
async def test_values_come_as_often_as_was_told(rested: Served, alone: Client, late: float, modified: bool) -> None:
    messages = await Messages(alone).create()
    told_intervals = []
    for asked, _ in ASKED:
        (created,) = await messages.create_items(POSITION, sampling=PUBLISH if modified else asked, queue=100)
        revised = created.RevisedSamplingInterval
        if modified:
            handle = messages.handles - 1
            revised = (
                await messages.modify(created.MonitoredItemId, handle, sampling=asked, queue=100)
            ).RevisedSamplingInterval
        told_intervals.append(revised)
    await messages.publish()

    for number in range(SCANS):
        rested.exchange.set("AxisX.Position", 100.0 + number)
        await rested.scan(0.05 + late * (-1) ** number)

    assert [expected for _, expected in ASKED] == told_intervals
    handles = [handle for handle, _, _ in told(await messages.publish())]
    for handle, (_, expected) in enumerate(ASKED):
        assert handles.count(handle) == pytest.approx(SCANS * PUBLISH / expected, abs=1)  # where the grid begins


async def test_an_item_as_fast_as_its_subscription_stays_so_when_that_is_modified(
    rested: Served, alone: Client
) -> None:
    messages = await Messages(alone, interval=200.0).create()
    (created,) = await messages.create_items(POSITION, sampling=-1.0, queue=100)
    await messages.publish()

    await messages.modify_subscription(10.0)
    for number in range(8):
        rested.exchange.set("AxisX.Position", 100.0 + number)
        await rested.scan()

    assert created.RevisedSamplingInterval == 200.0
    count = 0
    while not count:
        count = len(told(await messages.publish()))
    assert count == 2
