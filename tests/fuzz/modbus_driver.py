"""The whole Modbus driver against a lying device on a socket: what it reads is in the bytes, or the link is lost."""

import asyncio
import random
import time

import numpy as np

from softplc.clock import SystemClock
from softplc.drivers.modbus.config import ModbusSource, ModbusTag, TcpTransport
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.errors import LinkError
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.fuzz.modbus_client import honest, lies, verdict
from tests.fuzz.modbus_server import Result, WrongError, resident

_REQUEST = 12
_TIMEOUT_MS = (
    100.0  # what is missing is waited for; on a busy machine an honest reply may be late, which is a lost link
)
_PLACES = [300 * n + k for n in range(3) for k in range(1 + n)]  # three requests of one to three registers


class _Device:
    """Lies once in a read when it may. `requests` and `pieces` are those of the read that is on."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.may_lie, self.answered = False, 0
        self.forget()

    def forget(self) -> None:
        self.requests: list[bytes] = []
        self.pieces: list[tuple[int, bytes]] = []
        self.lied = False

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(4096):
                some = [data[at : at + _REQUEST] for at in range(0, len(data), _REQUEST)]
                replies = [honest(request, self.chance) for request in some]
                if lie := self.may_lie and not self.lied and self.chance.random() < 0.3:
                    self.lied = True
                stream = lies(replies, self.chance) if lie else b"".join(replies)
                self.requests += some
                self.pieces.append((len(self.requests), stream))
                self.answered += len(some)
                writer.write(stream)
        except ConnectionError:
            pass
        finally:
            writer.close()


async def _reads(device: _Device, port: int, replies: int) -> None:
    """Read until so many replies came, over a new link whenever one is lost. Raises WrongError."""
    fields = {"timeout_ms": _TIMEOUT_MS, "connect_timeout_ms": 5000.0, "in_flight": 4, "max_gap": 0}
    source = ModbusSource(type="modbus", name="plc", transport=TcpTransport(host="127.0.0.1", port=port), **fields)
    tags = [ModbusTag(source="plc", address=f"holding:{n}", data_type="uint16") for n in _PLACES]
    clock, image = SystemClock(), Image(len(tags))
    while device.answered < replies:
        driver = ModbusDriver(source, tags, (), clock)
        device.may_lie = False
        try:
            await driver.open()
            device.may_lie = True
            while device.answered < replies:
                device.forget()
                await driver.read(image)
                _judge(device, image)
        except LinkError:
            pass
        finally:
            await driver.close()
    clock.close()


def _judge(device: _Device, image: Image) -> None:
    """Hold a read that succeeded against the bytes."""
    right = verdict(device.requests, device.pieces)
    if right.fault or len(right.replies) < len(device.requests):
        raise WrongError(f"read from {device.pieces}")
    found = {}
    for number, reply in right.replies.items():
        first = int.from_bytes(device.requests[number][8:10], "big")
        count = int.from_bytes(device.requests[number][10:12], "big")
        values = np.frombuffer(reply, ">u2").tolist() if isinstance(reply, bytes) else [None] * count
        found |= {first + k: value for k, value in enumerate(values)}  # the last word on each register
    for value, status, place in zip(image.values, image.statuses, _PLACES, strict=True):
        good = status == StatusCode.GOOD
        if good != (found.get(place) is not None) or (good and value != found[place]):
            raise WrongError(f"register {place} is {value}, {status:08X}; the bytes say {found.get(place)}")


def over_sockets(replies: int, seed: int) -> Result:
    """So many replies of a lying device to the driver, over a socket."""

    async def run() -> Result:
        device, before, begun = _Device(seed), resident(), time.perf_counter()
        async with await asyncio.start_server(device.serve, "127.0.0.1", 0) as listener:
            await _reads(device, listener.sockets[0].getsockname()[1], replies)
        return Result(device.answered, time.perf_counter() - begun, resident() - before)

    return asyncio.run(run())
