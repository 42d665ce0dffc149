"""What holds of the driver whoever the device is: configuration, time stamps, opening, errors."""

import time

import numpy as np
import pytest

from softplc.clock import SystemClock, monotonic
from softplc.drivers.modbus.config import ModbusTag, RtuTransport
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.errors import ConfigError, LinkError
from softplc.interfaces import Driver
from softplc.tags import Image
from tests.drivers_modbus.support import opened, plain_device, pymodbus_server, read, source, tag
from tests.support.drivers import write_values


def test_build_makes_a_driver():
    driver: Driver = source(502).build([tag(40001)], [], SystemClock(), 0.05)

    assert isinstance(driver, ModbusDriver)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"address": 40000}, "source plc: 40000 is outside 40001…49999"),
        ({"address": "holding:70000"}, "source plc: 'holding:70000': offset 70000 is outside 0…65535"),
        ({"address": "coil:3"}, "source plc: 00004 / coil:3 is a single bit, found float32, expected bool"),
        (
            {"address": "holding:65535"},
            "source plc: 465536 / holding:65535: float32 takes 2 registers, but 465536 / holding:65535 is the last",
        ),
        ({"address": 40001, "scale": 0.0}, "40001 / holding:0 float32: found scale 0, expected any other number"),
        (
            {"address": 40001, "data_type": "float64"},
            "found max_registers 2, but a value of 4 registers must not be split; expected 4 or more",
        ),
    ],
)
@pytest.mark.parametrize("role", ["reading", "writing"])
def test_a_tag_that_cannot_be_is_a_configuration_error(fields, message, role):
    wrong = [ModbusTag(source="plc", **fields)]

    with pytest.raises(ConfigError) as error:
        ModbusDriver(
            source(502, max_registers=2),
            wrong if role == "reading" else [],
            wrong if role == "writing" else [],
            SystemClock(),
        )

    assert message in str(error.value)


def test_unit_0_on_a_serial_line_is_a_configuration_error():
    line = RtuTransport(type="rtu", device="/dev/null")

    with pytest.raises(ConfigError, match="unit_id 0 is the broadcast"):
        ModbusDriver(source(1, transport=line, unit_id=0), [], [], SystemClock())


def test_a_tag_is_shown_in_both_notations():
    assert str(tag("HR0")) == "40001 / holding:0 float32"
    assert str(tag("no address")) == "no address float32"


async def test_samples_carry_wall_time_and_monotonic_time_of_their_arrival():
    async with (
        pymodbus_server(plain_device()) as port,
        opened(source(port), [tag(40001), tag("coil:0", "bool")]) as driver,
    ):
        before = monotonic(), time.time_ns()
        image = await read(driver, 2)
        after = monotonic(), time.time_ns()

    assert (image.arrivals >= before[0]).all()
    assert (image.arrivals <= after[0]).all()
    assert (image.source_timestamps >= before[1]).all()
    assert (image.source_timestamps <= after[1]).all()


async def test_bad_samples_carry_the_time_of_the_refusal():
    async with pymodbus_server(plain_device()) as port, opened(source(port), [tag("holding:500")]) as driver:
        before = monotonic()
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
        assert await write_values(driver, {}) == {}


async def test_a_driver_that_is_not_open_is_an_error_and_closes_quietly():
    driver = ModbusDriver(source(1), [tag(40001)], [tag(40001)], SystemClock())

    with pytest.raises(LinkError, match="not open"):
        await driver.read(Image(1))
    with pytest.raises(LinkError, match="not open"):
        await write_values(driver, {0: 1.0})
    await driver.close()


async def test_a_closed_driver_reads_nothing_more():
    async with pymodbus_server(plain_device()) as port, opened(source(port), [tag(40001)]) as driver:
        await driver.close()
        with pytest.raises(LinkError, match="closed"):
            await driver.read(Image(1))
