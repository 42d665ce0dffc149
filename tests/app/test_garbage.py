import asyncio
import gc
import weakref
from collections.abc import Iterator

import pytest

from softplc.app import garbage
from softplc.app.garbage import Slack, freeze_garbage
from softplc.clock import VirtualClock
from softplc.timing import Scan

PERIOD = 0.05


class Node:
    me: "Node"


def litter() -> tuple["weakref.ref[Node]", list[object]]:
    """A cycle that only the collector finds, and enough new objects for a collection to be due."""
    node = Node()
    node.me = node
    return weakref.ref(node), [[] for _ in range(20_000)]


@pytest.fixture
def slack() -> Iterator[tuple[Slack, VirtualClock]]:
    clock = VirtualClock()
    gc.collect()
    yield Slack(clock), clock
    gc.enable()
    gc.unfreeze()
    gc.set_threshold(700, 10, 10)


def scan(start: float) -> Scan:
    return Scan(1, start, 0, PERIOD, PERIOD, 0)


def test_freezing_hides_what_exists_from_the_collector(slack):
    freeze_garbage()
    assert gc.get_freeze_count() > 1000


async def test_what_a_scan_leaves_behind_is_collected_after_it_and_not_within(slack):
    collector, clock = slack
    left, new = litter()
    assert left() is not None
    collector.after(scan(clock.monotonic()))
    assert left() is not None
    await asyncio.sleep(0)
    assert left() is None
    del new


async def test_nothing_is_collected_when_the_next_scan_is_due(slack):
    collector, clock = slack
    left, new = litter()
    collector.after(scan(clock.monotonic() - PERIOD))
    await asyncio.sleep(0)
    assert left() is not None
    del new


async def test_without_any_slack_it_is_collected_in_the_end(slack, monkeypatch):
    monkeypatch.setattr(garbage, "_AT_LATEST", 15_000)
    collector, clock = slack
    left, new = litter()
    collector.after(scan(clock.monotonic() - PERIOD))
    await asyncio.sleep(0)
    assert left() is None
    del new


async def test_a_scan_that_leaves_little_behind_costs_no_collection(slack):
    collector, clock = slack
    node = Node()
    node.me = node
    left = weakref.ref(node)
    del node
    collector.after(scan(clock.monotonic()))
    await asyncio.sleep(0)
    assert left() is not None
