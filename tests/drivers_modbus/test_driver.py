"""What holds of the driver whoever the device is: configuration, time stamps, opening, errors."""

import time

import numpy as np
import pytest
from pydantic import ValidationError

from softplc.clock import SystemClock
from softplc.drivers.modbus.config import ModbusSource, ModbusTag, RtuTransport
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.errors import ConfigError, LinkError
from softplc.interfaces import Driver
from softplc.tags import Image
from tests.drivers_modbus.support import opened, plain_device, pymodbus_server, read, source, tag


def test_build_makes_a_driver():
    driver: Driver = source(502).build([tag(40001)], [], SystemClock(), 0.05)

    assert isinstance(driver, ModbusDriver)


@pytest.mark.parametrize(
    ("fields", "place", "message"),
    [
        ({"address": 40000}, "address", "40000 is outside 40001…49999"),
        ({"address": "holding:70000"}, "address", "offset 70000 is outside 0…65535"),
        ({"address": "coil:3"}, "data_type", "00004 / coil:3 is a single bit, float32 is not; expected bool"),
        ({"address": "holding:65535"}, "data_type", "float32 takes 2 registers"),
        ({"address": 40001, "data_type": "int64", "byte_order": "ABDC"}, "byte_order", "Input should be 'ABCD'"),
        (
            {"address": 40001, "data_type": "int16", "byte_order": "CDAB"},
            "byte_order",
            "int16 takes one register and knows no byte order",
        ),
        ({"address": 40001, "scale": 0.0}, "scale", "a scale of 0"),
    ],
)
def test_a_wrong_tag_is_refused_at_its_key(fields, place, message):
    with pytest.raises(ValidationError) as error:
        ModbusTag(source="plc", **fields)

    (found,) = error.value.errors()
    assert found["loc"] == (place,)
    assert message in found["msg"]


def test_unit_0_on_a_serial_line_is_refused():
    with pytest.raises(ValidationError, match="broadcast"):
        ModbusSource(type="modbus", name="plc", transport=RtuTransport(type="rtu", device="/dev/null"), unit_id=0)


def test_a_tag_is_shown_in_both_notations():
    assert str(tag("HR0")) == "40001 / holding:0 float32"


def test_a_value_longer_than_the_devices_limit_is_a_configuration_error():
    with pytest.raises(ConfigError, match="source plc: max_registers is 2, but there is a value of 4 registers"):
        ModbusDriver(source(502, max_registers=2), [tag(40001, "float64")], [], SystemClock())


async def test_samples_carry_wall_time_and_monotonic_time_of_their_arrival():
    async with (
        pymodbus_server(plain_device()) as port,
        opened(source(port), [tag(40001), tag("coil:0", "bool")]) as driver,
    ):
        before = time.monotonic(), time.time_ns()
        image = await read(driver, 2)
        after = time.monotonic(), time.time_ns()

    assert (image.arrivals >= before[0]).all()
    assert (image.arrivals <= after[0]).all()
    assert (image.source_timestamps >= before[1]).all()
    assert (image.source_timestamps <= after[1]).all()


async def test_bad_samples_carry_the_time_of_the_refusal():
    async with pymodbus_server(plain_device()) as port, opened(source(port), [tag("holding:500")]) as driver:
        before = time.monotonic()
        image = await read(driver, 1)

    assert np.isnan(image.values).all()
    assert image.arrivals[0] >= before
    assert image.source_timestamps[0] > 0


async def test_two_tags_on_one_address_both_read_it():
    tags = [tag("holding:10", "uint16"), tag("holding:10", "uint32"), tag("holding:10", "uint16", scale=2.0)]
    async with pymodbus_server(plain_device()) as port, opened(source(port), tags) as driver:
        image = await read(driver, 3)

    assert image.values.tolist() == [10.0, 10 * 65536.0 + 11, 20.0]


async def test_a_source_that_is_only_written_opens_and_reads_nothing():
    async with pymodbus_server(plain_device()) as port, opened(source(port), [], [tag(40001)]) as driver:
        await driver.read(Image(0))
        assert await driver.write({}) == {}


async def test_a_driver_that_is_not_open_is_an_error_and_closes_quietly():
    driver = ModbusDriver(source(1), [tag(40001)], [tag(40001)], SystemClock())

    with pytest.raises(LinkError, match="not open"):
        await driver.read(Image(1))
    with pytest.raises(LinkError, match="not open"):
        await driver.write({0: 1.0})
    await driver.close()


async def test_a_closed_driver_reads_nothing_more():
    async with pymodbus_server(plain_device()) as port, opened(source(port), [tag(40001)]) as driver:
        await driver.close()
        with pytest.raises(LinkError, match="closed"):
            await driver.read(Image(1))
