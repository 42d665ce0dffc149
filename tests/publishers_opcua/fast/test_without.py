"""A server without the fast path tells the same."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from asyncua import Client, ua

from tests.publishers_opcua.conftest import Served, serve
from tests.publishers_opcua.test_monitoring import (
    test_a_dead_band_in_percent_is_of_the_range,
    test_a_modified_item_follows_its_new_filter_and_interval,
    test_a_monitored_item_that_is_disabled_is_silent_until_it_is_enabled,
    test_a_slow_tag_moves_under_an_absolute_dead_band,
    test_a_slower_sampling_interval_gets_every_nth_value_and_the_last,
)
from tests.publishers_opcua.test_publishing import test_every_tag_reads_as_the_snapshot_says

__all__ = [
    "test_a_dead_band_in_percent_is_of_the_range",
    "test_a_modified_item_follows_its_new_filter_and_interval",
    "test_a_monitored_item_that_is_disabled_is_silent_until_it_is_enabled",
    "test_a_slow_tag_moves_under_an_absolute_dead_band",
    "test_a_slower_sampling_interval_gets_every_nth_value_and_the_last",
    "test_every_tag_reads_as_the_snapshot_says",
]
pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served() -> AsyncIterator[Served]:
    async with serve(fast=False) as served:
        yield served


async def test_nothing_of_it_is_there(calm: Served, client: Client) -> None:
    found = await client.uaclient.read_attributes([ua.NodeId("AxisX.Position", 2)], ua.AttributeIds.Value)

    inner = calm.server._server.iserver
    assert (inner.reads, inner.sweep, calm.server.slow, found[0].Value.Value) == (None, None, (0, 0), 1.0)
