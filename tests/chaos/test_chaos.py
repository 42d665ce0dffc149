"""The chaos suite in its short form; `python3 dev.py chaos` runs the long one and prints the table."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.chaos.claims import SHORT
from tests.chaos.rig import Rig, our_rig, rig
from tests.chaos.rows import ROWS, Row

pytestmark = [pytest.mark.chaos, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def npm(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with rig(tmp_path_factory.mktemp("chaos")) as made:
        yield made


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def ours(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with our_rig(tmp_path_factory.mktemp("chaos")) as made:
        yield made


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name.replace(" ", "-"))
async def test_third_party_sources(npm: Rig, row: Row):
    print(row.fault, "→", row.expectation)
    print(await row.run(npm, SHORT))


OURS = [row for row in ROWS if row.name in ("reset", "stopped")]


@pytest.mark.parametrize("row", OURS, ids=lambda row: row.name)
async def test_our_own_sources(ours: Rig, row: Row):
    print(row.fault, "→", row.expectation)
    print(await row.run(ours, SHORT))
