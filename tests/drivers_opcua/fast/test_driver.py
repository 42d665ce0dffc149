"""The driver on the fast path: which messages take it, what asyncua's decoder is left with, and the guard."""

import asyncio
import math

import pytest
import structlog
from asyncua import ua

from softplc import asyncua_version
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_opcua.opened import opened, read
from tests.drivers_opcua.servers import NUMBERS, AsyncuaPlc, NodePlc
from tests.support.drivers import write_values

AXIS = "ns=2;s=PLC.Axis"


async def test_numbers_of_every_type_good_and_bad_need_no_decoder_but_ours(plc: NodePlc):
    tags = [f"{AXIS}.{name}" for name in (*NUMBERS, "Bad", "Uncertain", "NaN", "Ramp", "Nope")]
    async with opened(plc.url, tags) as driver:
        for _ in range(3):
            image = await read(driver, len(tags))

    assert image.values[: len(NUMBERS)].tolist() == list(NUMBERS.values())
    assert image.statuses[-1] == StatusCode.BAD_NODE_ID_UNKNOWN
    assert (driver.slow.messages, driver.slow.values) == (0, 0)


async def test_an_array_or_a_text_is_decoded_by_asyncua_and_the_others_are_not(plc: NodePlc):
    tags = [f"{AXIS}.Double", (f"{AXIS}.Doubles", 2), f"{AXIS}.Text", f"{AXIS}.Int16"]
    async with opened(plc.url, tags) as driver:
        image = await read(driver, 4)

    assert image.values.tolist()[:2] == [1e300, 12.5]
    assert math.isnan(image.values[2])
    assert image.values[3] == -32768.0
    assert image.statuses.tolist() == [0, 0, StatusCode.BAD_TYPE_MISMATCH, 0]
    assert (driver.slow.messages, driver.slow.values) == (0, 2)


async def test_a_value_that_comes_and_goes_is_followed_through_all_its_layouts(asyncua_plc: AsyncuaPlc):
    tags = [f"ns={asyncua_plc.index};s={name}" for name in ("Plain", "Moving", "NoStamp")]
    double, bad = ua.VariantType.Double, ua.StatusCode(StatusCode.BAD_SENSOR_FAILURE)
    async with opened(asyncua_plc.url, tags) as driver:
        image = Image(3)
        for number in range(12):
            kinds = (ua.DataValue(ua.Variant(float(number), double)), ua.DataValue(None, bad))
            asyncua_plc.write("Moving", kinds[number % 2])
            await driver.read(image)
            assert image.values[[0, 2]].tolist() == [1.5, 2.5]
            assert image.statuses[1] == (StatusCode.BAD_SENSOR_FAILURE if number % 2 else 0)
            assert math.isnan(image.values[1]) if number % 2 else image.values[1] == number
    assert (driver.slow.messages, driver.slow.values) == (0, 0)


async def test_an_asyncua_that_was_not_proven_is_told_once_and_used_as_it_is(
    plc: NodePlc, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(asyncua_version, "PROVEN", frozenset({"0.0.1"}))
    asyncua_version.proven.cache_clear()
    try:
        with structlog.testing.capture_logs() as told:
            for _ in range(2):
                async with opened(plc.url, [f"{AXIS}.Double"], [f"{AXIS}.Target"]) as driver:
                    image = await read(driver, 1)
                    assert image.values.tolist() == [1e300]
                    read_so_far = driver.slow_path
                    assert read_so_far > 0  # the tag SlowPath counts what asyncua decoded, as with an odd message
                    assert await write_values(driver, {0: 2.5}) == {0: StatusCode.GOOD}
                    assert driver.slow_path == read_so_far + 1
    finally:
        asyncua_version.proven.cache_clear()

    warnings = [line for line in told if "asyncua" in line["event"]]
    assert [(line["by"], line["expected"]) for line in warnings] == [("client", "0.0.1")]


def test_the_installed_asyncua_is_one_that_the_codec_was_compared_with():
    assert asyncua_version.proven("client")


async def test_changes_of_every_number_type_need_no_decoder_but_ours(plc: NodePlc):
    tags = [f"{AXIS}.{name}" for name in (*NUMBERS, "Bad", "Uncertain", "NaN", "Ramp")]
    async with opened(plc.url, tags, mode="subscribe", sampling_ms=20, publishing_ms=20) as driver:
        image = Image(len(tags))
        before = math.nan
        for _ in range(200):  # Ramp goes on
            await driver.read(image)
            if image.values[-1] != before and not math.isnan(before):
                break
            before = float(image.values[-1])
            await asyncio.sleep(0.02)

    assert image.values[: len(NUMBERS)].tolist() == list(NUMBERS.values())
    assert image.values[-1] != before
    assert driver.slow_path == 0
