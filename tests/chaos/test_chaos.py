"""The chaos suite in its short form, with third-party sources; `python3 dev.py chaos` runs the long one.

`python3 dev.py chaos --quick --ours` has the same rows against softplc's own emulator.
"""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from tests.chaos.claims import SHORT
from tests.chaos.rig import Rig, rig
from tests.chaos.rows import ROWS, Row

pytestmark = [pytest.mark.chaos, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def npm(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with rig(tmp_path_factory.mktemp("chaos")) as made:
        yield made


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name.replace(" ", "-"))
async def test_third_party_sources(npm: Rig, row: Row):
    print(row.fault, "→", row.expectation)
    print(await row.run(npm, SHORT))
