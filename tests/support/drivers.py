"""A driver whose device is a Python object: for tests of the link and of the scan, on a virtual clock."""

import asyncio
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.errors import LinkError
from softplc.interfaces import Driver, Positions
from softplc.tags import Image


class Device:
    """What the driver talks to. `reachable` False refuses connections; `silent` never answers;
    one that is deaf to writes costs the connection with each. `old_replies`: the values of a late reply are those
    of the time when it was asked. Values by position."""

    def __init__(self, clock: Clock, readings: int = 1) -> None:
        self.clock = clock
        self.values = [0.0] * readings
        self.statuses = [0] * readings
        self.stamps: list[int] | None = None  # ns UTC; those of the moment when left out
        self.reachable = True
        self.silent = False
        self.broken = False
        self.deaf_to_writes = False
        self.old_replies = False
        self.delay = 0.0  # seconds until a reply
        self.written: list[dict[int, float]] = []
        self.write_status = 0
        self.attempts = 0
        self.opened = 0
        self.closed = 0
        self.outstanding = 0
        self.most_outstanding = 0

    def driver(self) -> "DeviceDriver":
        return DeviceDriver(self)


class DeviceDriver:
    """One connection to a Device."""

    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    writes_at_once = 100

    def __init__(self, device: Device) -> None:
        self._device = device

    async def open(self) -> None:
        self._device.attempts += 1
        if not self._device.reachable:
            raise LinkError("connection refused")
        self._device.opened += 1

    async def read(self, into: Image) -> None:
        device = self._device
        asked = list(device.values)
        await self._answer()
        into.values[:] = asked if device.old_replies else device.values
        into.statuses[:] = device.statuses
        into.source_timestamps[:] = device.clock.utc_ns() if device.stamps is None else device.stamps
        into.arrivals[:] = device.clock.monotonic()

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        await self._answer()
        if self._device.deaf_to_writes:
            raise LinkError("write not confirmed")
        self._device.written.append(dict(zip(positions.tolist(), values.tolist(), strict=True)))
        return np.full(len(positions), self._device.write_status, np.uint32)

    async def close(self) -> None:
        self._device.closed += 1

    async def _answer(self) -> None:
        device = self._device
        device.outstanding += 1
        device.most_outstanding = max(device.most_outstanding, device.outstanding)
        try:
            if not device.reachable:
                raise LinkError("connection reset")
            if device.broken:
                raise ZeroDivisionError("a defect of the driver")
            if device.delay:
                await asyncio.sleep(device.delay)
            while device.silent:
                await asyncio.sleep(0.001)
        finally:
            device.outstanding -= 1


async def write_values(driver: Driver, values: Mapping[int, float]) -> dict[int, int]:
    """Write to a driver by position; the status of each."""
    positions = np.array(list(values), np.intp)
    statuses = await driver.write(positions, np.array(list(values.values()), np.float64))
    assert statuses.dtype == np.uint32
    return dict(zip(values, statuses.tolist(), strict=True))
