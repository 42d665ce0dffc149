"""A variable that is another kind of number than it was is Bad until it is right again; the others live."""

import gc
import math

from asyncua import ua

from softplc.drivers.opcua.driver import REBIND
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_opcua.conftest import StartPlc
from tests.drivers_opcua.opened import ForwardClock, make_driver, make_tag, opened, read, read_until
from tests.drivers_opcua.paths import PATHS, every_path, on
from tests.drivers_opcua.servers import AsyncuaPlc
from tests.support.network import free_port

V = ua.VariantType
AXIS = "nsu=urn:softplc:test:plc;s=PLC.Axis"


def variant(value: object, variant_type: ua.VariantType, **more: bool) -> ua.DataValue:
    return ua.DataValue(ua.Variant(value, variant_type, **more))


@every_path
async def test_a_type_that_changes_at_run_time_is_bad_until_it_is_right_again(asyncua_plc: AsyncuaPlc, path: str):
    clock = ForwardClock()
    tags = [f"ns={asyncua_plc.index};s={name}" for name in ("Moving", "Plain")]
    asyncua_plc.write("Moving", variant(1.5, V.Double))
    with on(path) as mode:
        async with opened(asyncua_plc.url, tags, clock=clock, mode=mode) as driver:
            image = await read(driver, 2)
            changes = [
                (variant(7, V.Int32), None),
                (variant(8, V.Int32), None),
                (variant(2.5, V.Float), 2.5),  # LREAL to REAL is the same kind
                (variant(True, V.Boolean), None),
                (variant([1.0, 2.0], V.Double, is_array=True), None),
                (variant("nine", V.String), None),
                (variant(3.5, V.Double), 3.5),
            ]
            for value, taken in changes:
                asyncua_plc.write("Moving", value)
                bad = taken is None
                await read_until(
                    driver,
                    image,
                    lambda taken=taken, bad=bad: bad == math.isnan(image.values[0]) or taken == image.values[0],
                )
                for _ in range(3):
                    await driver.read(image)
                    assert image.statuses.tolist() == [StatusCode.BAD_TYPE_MISMATCH if bad else 0, 0]
                    assert image.values[1] == 1.5
                if value.Value.VariantType is V.Int32:
                    assert "is Int32 now and was Double; expected Double again" in driver.problems[0]
            clock.ahead += REBIND
            await read_until(driver, image, lambda: not driver.problems)
            assert image.values.tolist() == [3.5, 1.5]


async def test_a_plc_that_comes_back_with_another_type_is_bad_until_that_is_right(start_plc: StartPlc):
    """REAL to DINT with a new program: the number would be read, and mean something else."""
    tags = [f"{AXIS}.{name}" for name in ("Float", "Int16", "Bool")]
    port = free_port()
    url, modes = f"opc.tcp://127.0.0.1:{port}", ("poll", "poll", "subscribe")
    # one configuration for all connections of a source; the timeouts only tell the three apart
    configs = [make_driver(url, [], timeout_ms=9000.0 + n, mode=mode)._config for n, mode in enumerate(modes)]
    for changed in ({}, {"Float": "Int32", "Int16": "Int32", "Bool": "Byte"}, {}):
        plc = start_plc(port, **{"as": changed})
        for path, config in zip(PATHS, configs, strict=True):
            with on(path):
                driver = config.build([make_tag(tag) for tag in tags], [], ForwardClock(), 0.05)
                await driver.open()
                image = await read(driver, 3)
                await driver.close()
                told = "; ".join(driver.problems)
            if changed:
                assert image.statuses.tolist() == [StatusCode.BAD_TYPE_MISMATCH, 0, StatusCode.BAD_TYPE_MISMATCH]
                assert image.values[1] == -32768.0  # INT to DINT is the same kind
                assert "is Int32 now and was Float; expected Float again" in told
                assert "is Byte now and was Boolean" in told
            else:
                assert image.values.tolist() == [0.5, -32768.0, 1.0]
                assert told == ""
        plc.kill()


async def test_a_new_start_takes_the_types_as_they_are(asyncua_plc: AsyncuaPlc):
    tag = f"ns={asyncua_plc.index};s=Moving"
    for value in (variant(1.5, V.Double), variant(7, V.Int64), variant(True, V.Boolean)):
        asyncua_plc.write("Moving", value)
        async with opened(asyncua_plc.url, [tag]) as driver:
            assert (await read(driver, 1)).values[0] == float(value.Value.Value)
        del driver
        gc.collect()


@every_path
async def test_the_first_number_decides_also_where_there_was_none_at_the_start(asyncua_plc: AsyncuaPlc, path: str):
    asyncua_plc.write("Moving", ua.DataValue(None, ua.StatusCode(StatusCode.BAD_SENSOR_FAILURE)))
    with on(path) as mode:
        async with opened(asyncua_plc.url, [f"ns={asyncua_plc.index};s=Moving"], mode=mode) as driver:
            image = Image(1)
            asyncua_plc.write("Moving", variant(7, V.Int32))
            await read_until(driver, image, lambda: image.values[0] == 7.0)
            asyncua_plc.write("Moving", variant(7.5, V.Float))
            await read_until(driver, image, lambda: image.statuses[0] == StatusCode.BAD_TYPE_MISMATCH)
