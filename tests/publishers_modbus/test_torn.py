"""While another process publishes as fast as it can, no client ever sees half a value or half a scan."""

import multiprocessing
from typing import Any

import numpy as np

from softplc.clock import SystemClock
from softplc.exchange import Reader, Writer, size
from softplc.publishers.modbus.server import ModbusServer
from softplc.tags import Image, TagTable
from softplc.timing import Scan
from tests.publishers_modbus.support import Client, any_port, plant, request
from tests.support.network import eventually

AXES = 300  # so many that copying a scan takes as long as a torn copy needs to be caught
BURSTS = 500
SCANS = 200  # that many different scans must have been seen, or nothing was shown
BETWEEN = 3000  # turns of an empty loop between two scans, some 50 µs: a reader that finds no gap shows nothing
BURST = b"".join(request(3000 + 64 * axis, 26) for axis in (0, 75, 150, 225, 299))  # each an axis' first 13 floats


def pattern(number: int) -> float:
    """A float32 whose upper register is 0x4000 … 0x5fff and whose lower register is its complement."""
    upper = 0x4000 + number % 0x2000
    return float(np.array([upper << 16 | ~upper & 0xFFFF], np.uint32).view(np.float32)[0])


def table() -> TagTable:
    return plant(axes=AXES)


def publish_at_full_speed(buffer: Any, stop: Any) -> None:
    """All values of scan n are pattern(n)."""
    tags, clock = table(), SystemClock()
    writer, image = Writer(buffer, tags), Image(len(tags))
    image.statuses[:] = 0
    number = 0
    while not stop.is_set():
        for _ in range(1000):
            number += 1
            image.values[:] = pattern(number)
            for _ in range(BETWEEN):
                pass
            writer.publish(0, Scan(number, clock.monotonic(), clock.utc_ns(), 0.05, 0.05, 0), image)


async def test_no_client_ever_reads_half_a_value_or_half_a_scan():
    context = multiprocessing.get_context("spawn")
    tags = table()
    buffer, stop = context.RawArray("b", size(tags)), context.Event()
    process = context.Process(target=publish_at_full_speed, args=(buffer, stop), daemon=True)
    process.start()
    server = ModbusServer(any_port(), Reader(buffer, tags, SystemClock()))
    port = int((await server.open()).rpartition(":")[2])
    try:
        await eventually(lambda: server.registers()[22:24] == b"\x00\x01", seconds=60, what="the first scan")
        client = await Client.connect(port)
        seen, bursts = set(), 0
        while bursts < BURSTS or len(seen) < SCANS:
            bursts += 1
            client.writer.write(BURST)
            replies = [(await client.receive())[2] for _ in range(5)]
            words = np.frombuffer(b"".join(pdu[2:] for pdu in replies), ">u2").astype(np.uint16).reshape(-1, 2)
            assert np.array_equal(words[:, 1], ~words[:, 0])  # no half-old value
            scans = set(words[:, 0].tolist())
            assert len(scans) == 1  # one segment is one burst, and one burst shows one scan
            seen |= scans
        await client.close()
    finally:
        stop.set()
        await server.close()
        process.join(20)
        if process.is_alive():
            process.kill()
            process.join()
    assert process.exitcode == 0
