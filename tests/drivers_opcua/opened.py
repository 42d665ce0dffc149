"""Drivers for the tests: configured in one line, opened, always closed; a clock that can be put forward."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any

from softplc.clock import Clock, SystemClock
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag
from softplc.drivers.opcua.driver import OpcUaDriver
from softplc.tags import Image

PERIOD = 0.05
Tag = str | tuple[str, int]


class ForwardClock(SystemClock):
    """The machine's clock, which a test may put forward instead of waiting."""

    ahead = 0.0

    def monotonic(self) -> float:
        return super().monotonic() + self.ahead


def make_tag(tag: Tag) -> OpcUaTag:
    node, index = (tag, None) if isinstance(tag, str) else tag
    return OpcUaTag(source="plc", node=node, index=index)


def make_driver(
    url: str,
    readings: Sequence[Tag],
    writings: Sequence[Tag] = (),
    clock: Clock | None = None,
    stamped: Sequence[int] = (),
    **config: Any,
) -> OpcUaDriver:
    """A driver with timeouts that a busy test machine keeps, unless the test says otherwise."""
    settings = {"timeout_ms": 10_000.0, "connect_timeout_ms": 30_000.0, "stale_after_ms": 30_000.0, **config}
    source = OpcUaSource(type="opcua", name="plc", url=url, **settings)
    tags, targets = [make_tag(tag) for tag in readings], [make_tag(tag) for tag in writings]
    driver = source.build(tags, targets, clock or SystemClock(), PERIOD, stamped)
    assert isinstance(driver, OpcUaDriver)
    return driver


@asynccontextmanager
async def opened(
    url: str,
    readings: Sequence[Tag],
    writings: Sequence[Tag] = (),
    clock: Clock | None = None,
    stamped: Sequence[int] = (),
    **config: Any,
) -> AsyncIterator[OpcUaDriver]:
    driver = make_driver(url, readings, writings, clock, stamped, **config)
    await driver.open()
    try:
        yield driver
    finally:
        await driver.close()


async def read(driver: OpcUaDriver, count: int) -> Image:
    image = Image(count)
    await driver.read(image)
    return image


async def read_until(driver: OpcUaDriver, image: Image, condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Read as scans do, until the image is as expected."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not so within {seconds} s: {image.values} {image.statuses}"
        await driver.read(image)
        await asyncio.sleep(0.01)
