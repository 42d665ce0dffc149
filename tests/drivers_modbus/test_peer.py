"""The driver against a third-party server: modbus-serial on Node, values encoded by Node's Buffer."""

import math

import numpy as np
import pytest

from softplc.sample import StatusCode
from tests.drivers_modbus.support import opened, read, running_peer, source, tag
from tests.support.drivers import write_values

ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")
VALUES = {
    "bool": True,
    "int16": -12345,
    "uint16": 54321,
    "int32": -123456789,
    "uint32": 3123456789,
    "int64": -1234567890123456,
    "uint64": 1234567890123456,
    "float32": -123.456,
    "float64": math.pi,
}
STEP = 4  # registers from one value to the next


def expected(data_type: str) -> float:
    value = VALUES[data_type]
    return float(np.float32(value)) if data_type == "float32" else float(value)


@pytest.fixture
async def peer():
    async with running_peer() as running:
        yield running


def everything(table: str) -> list[tuple[str, str, int]]:
    """Every type in every order: (type, order, offset)."""
    cases = [(data_type, order) for data_type in VALUES for order in ORDERS]
    return [(data_type, order, STEP * i) for i, (data_type, order) in enumerate(cases)]


def order_of(data_type: str, order: str) -> str | None:
    return order if data_type.endswith(("32", "64")) else None


@pytest.mark.parametrize("table", ["holding", "input"])
async def test_every_type_and_order_reads_as_the_peer_encoded_it(peer, table):
    cases = everything(table)
    for data_type, order, offset in cases:
        await peer.put(table, offset, VALUES[data_type], data_type, order)
    tags = [tag(f"{table}:{o}", t, byte_order=order_of(t, b)) for t, b, o in cases]

    async with opened(source(peer.port, unit_id=17), tags) as driver:
        image = await read(driver, len(tags))

    assert image.values.tolist() == [expected(data_type) for data_type, _, _ in cases]
    assert set(image.statuses.tolist()) == {StatusCode.GOOD}


async def test_every_type_and_order_is_written_as_the_peer_decodes_it_and_reads_back(peer):
    cases = everything("holding")
    tags = [tag(f"holding:{o}", t, byte_order=order_of(t, b)) for t, b, o in cases]

    async with opened(source(peer.port), tags, tags) as driver:
        statuses = await write_values(driver, {i: float(VALUES[t]) for i, (t, _, _) in enumerate(cases)})
        image = await read(driver, len(tags))

    assert statuses == dict.fromkeys(range(len(cases)), StatusCode.GOOD)
    assert image.values.tolist() == [expected(data_type) for data_type, _, _ in cases]
    for data_type, order, offset in cases:
        text = await peer.get("holding", offset, data_type, order)
        assert (text == "true") if data_type == "bool" else (float(text) == expected(data_type))


async def test_coils_and_discrete_inputs_read_as_bits_and_coils_are_written(peer):
    on = {0, 3, 7, 8, 15, 16, 1999}
    for offset in on:
        await peer.put("coil", offset, True)
        await peer.put("discrete", offset, True)
    offsets = [*range(20), 1999]
    tags = [tag(f"{table}:{o}", "bool") for table in ("coil", "discrete") for o in offsets]

    async with opened(source(peer.port, max_gap=8), tags, [tag("coil:5", "bool"), tag("coil:0", "bool")]) as driver:
        image = await read(driver, len(tags))
        assert await write_values(driver, {0: 1.0, 1: 0.0}) == {0: StatusCode.GOOD, 1: StatusCode.GOOD}
        after = await read(driver, len(tags))

    assert image.values.tolist() == [float(o in on) for o in offsets] * 2
    assert after.values[[0, 5]].tolist() == [0.0, 1.0]
    assert (await peer.get("coil", 5), await peer.get("coil", 0)) == ("true", "false")


async def test_scale_and_offset_make_the_engineering_value_both_ways(peer):
    await peer.put("holding", 0, 2500, "int16")
    temperature = tag(40001, "int16", scale=0.01, offset=-5.0)

    async with opened(source(peer.port), [temperature], [temperature]) as driver:
        assert (await read(driver, 1)).values.tolist() == [20.0]
        assert await write_values(driver, {0: -5.12}) == {0: StatusCode.GOOD}

    assert await peer.get("holding", 0, "int16") == "-12"


async def test_neighbours_are_read_in_as_few_requests_as_the_limits_allow(peer):
    tags = [
        *(tag(f"holding:{2 * i}") for i in range(70)),
        tag("holding:200", "int16"),
        tag("input:0", "uint16"),
        tag("input:9", "uint16"),
        *(tag(f"coil:{i}", "bool") for i in range(40)),
    ]

    async with opened(source(peer.port, max_registers=100, max_gap=8), tags) as driver:
        await peer.requests()
        await read(driver, len(tags))

    assert await peer.requests() == [(1, 0, 40), (3, 0, 100), (3, 100, 40), (3, 200, 1), (4, 0, 10)]


async def test_values_in_several_registers_are_written_in_one_request(peer):
    tags = [tag("holding:10", "float64"), tag("holding:14", "uint16"), tag("coil:3", "bool")]

    async with opened(source(peer.port), [], tags) as driver:
        await write_values(driver, {0: 1.5, 1: 7.0, 2: 1.0})

    assert [request[:2] for request in await peer.requests()] == [(16, 10), (6, 14), (5, 3)]


async def test_a_device_without_function_6_is_written_with_function_16(peer):
    await peer.ask("refuseSingle", code=1)
    async with opened(source(peer.port), [], [tag("holding:4", "int16")]) as driver:
        assert await write_values(driver, {0: -3.0}) == {0: StatusCode.GOOD}
        assert await write_values(driver, {0: -4.0}) == {0: StatusCode.GOOD}

    assert [request[:2] for request in await peer.requests()] == [(6, 4), (16, 4), (16, 4)]
    assert await peer.get("holding", 4, "int16") == "-4"


@pytest.mark.parametrize(
    ("code", "status"),
    [
        (1, 0x803D0000),
        (2, StatusCode.BAD_CONFIGURATION_ERROR),
        (3, StatusCode.BAD_CONFIGURATION_ERROR),
        (4, StatusCode.BAD_DEVICE_FAILURE),
        (5, 0x80040000),
        (6, 0x80040000),
        (8, StatusCode.BAD_DEVICE_FAILURE),
        (10, StatusCode.BAD_NO_COMMUNICATION),
        (11, StatusCode.BAD_NO_COMMUNICATION),
        (99, StatusCode.BAD),
    ],
)
async def test_an_exception_response_is_the_status_of_that_requests_tags_alone(peer, code, status):
    await peer.refuse("holding", 50, code)
    await peer.put("holding", 0, 5, "int16")
    tags = [tag("holding:0", "int16"), tag("holding:50", "int16")]

    async with opened(source(peer.port), tags, tags) as driver:
        image = await read(driver, 2)
        written = await write_values(driver, {0: 6.0, 1: 6.0})

    assert image.statuses.tolist() == [StatusCode.GOOD, status]
    assert image.values[0] == 5.0
    assert math.isnan(image.values[1])
    assert written == {0: StatusCode.GOOD, 1: status}


async def test_an_undeclared_hole_in_a_request_costs_the_tags_around_it_nothing(peer):
    await peer.refuse("holding", 3, 2)
    await peer.put("holding", 0, 1.5, "float32")
    await peer.put("holding", 4, 2.5, "float32")
    tags = [tag("holding:0"), tag("holding:4")]

    async with opened(source(peer.port), tags) as driver:
        await peer.requests()
        image = await read(driver, 2)

    assert image.values.tolist() == [1.5, 2.5]
    assert await peer.requests() == [(3, 0, 2), (3, 4, 2)]


async def test_one_wrong_address_among_many_is_bad_alone_and_costs_few_requests(peer):
    n = 60
    for i in range(n):
        await peer.put("holding", 2 * i, float(i), "float32")
    await peer.refuse("holding", 2 * 37, 2)
    tags = [tag(f"holding:{2 * i}") for i in range(n)]

    async with opened(source(peer.port), tags) as driver:
        await peer.requests()
        first, second = await read(driver, n), await read(driver, n)
        requests = await peer.requests()
        await peer.refuse("holding", 2 * 37, 0)
        await read(driver, n)
        await peer.requests()
        healed = await read(driver, n)

    good = [i for i in range(n) if i != 37]
    for image in (first, second):
        assert image.statuses[37] == StatusCode.BAD_CONFIGURATION_ERROR
        assert math.isnan(image.values[37])
        assert image.values[good].tolist() == [float(i) for i in good]
    assert len(requests) / 2 <= 1 + math.log2(n) + 1  # the halves that answered, and the refused value itself
    assert healed.values.tolist() == [float(i) for i in range(n)]
    assert await peer.requests() == [(3, 0, 120)]


async def test_many_wrong_addresses_cost_one_request_a_read_together(peer):
    for offset in range(20, 40):
        await peer.refuse("input", offset, 2)
    tags = [tag(f"input:{i}", "uint16") for i in range(40)]

    async with opened(source(peer.port), tags) as driver:
        await peer.requests()
        images = [await read(driver, 40) for _ in range(20)]
        requests = await peer.requests()

    for image in images:
        assert image.statuses.tolist() == [StatusCode.GOOD] * 20 + [StatusCode.BAD_CONFIGURATION_ERROR] * 20
    assert len(requests) == 20 * 2
    assert sorted({address for _, address, _ in requests}) == [0, *range(20, 40)]  # every one was asked again


async def test_what_is_not_writable_or_does_not_fit_is_a_status_and_is_not_sent(peer):
    tags = [tag("input:0", "int16"), tag("discrete:0", "bool"), tag("holding:0", "int16"), tag("holding:2")]

    async with opened(source(peer.port), [], tags) as driver:
        statuses = await write_values(driver, {0: 1.0, 1: 1.0, 2: 40000.0, 3: math.nan})

    assert statuses == {
        0: StatusCode.BAD_NOT_WRITABLE,
        1: StatusCode.BAD_NOT_WRITABLE,
        2: StatusCode.BAD_OUT_OF_RANGE,
        3: StatusCode.BAD_OUT_OF_RANGE,
    }
    assert await peer.requests() == []


async def test_nan_and_infinity_from_the_device_pass_as_they_are(peer):
    tags = [tag("holding:0"), tag("holding:2")]
    await peer.put("holding", 0, 0x7FC00000, "uint32")
    await peer.put("holding", 2, 0xFF800000, "uint32")

    async with opened(source(peer.port), tags) as driver:
        image = await read(driver, 2)

    assert math.isnan(image.values[0])
    assert image.values[1] == -math.inf
    assert image.statuses.tolist() == [StatusCode.GOOD, StatusCode.GOOD]
