"""A server whose answers do not fit the request: never a wrong number, always a LinkError; on every codec."""

import struct
from collections.abc import Callable

import numpy as np
import pytest

from softplc.errors import LinkError
from softplc.tags import Image
from tests.drivers_opcua.opened import opened
from tests.drivers_opcua.paths import PATHS, on
from tests.drivers_opcua.servers import AsyncuaPlc
from tests.support.proxy import Proxy

CHUNK, TYPE, HEAD = 24, b"\x01\x00\x7a\x02", 28  # chunk's head; ReadResponse (i=634); what stands before the count
RECORD = 1 + 1 + 8 + 8  # mask, type, Double, source timestamp: Good is left out
Body = Callable[[bytes], bytes]


def results(body: bytes, count: int) -> bytes:
    return body[:HEAD] + struct.pack("<i", count) + body[HEAD + 4 :]


WRONG: dict[str, Body] = {
    "fewer results than asked": lambda body: results(body, 1),
    "fewer results, and bytes for those alone": lambda body: results(body[: HEAD + 4 + RECORD] + body[-4:], 1),
    "more results than asked": lambda body: results(body, 3),
    "no results": lambda body: results(body[: HEAD + 4] + body[-4:], 0),
    "null instead of results": lambda body: results(body[: HEAD + 4] + body[-4:], -1),
    "two billion results": lambda body: results(body, 2**31 - 1),
    "cut short": lambda body: body[:-9],
    "a fault of the service": lambda body: body[:16] + struct.pack("<I", 0x80130000) + body[20:],
    "another response": lambda body: b"\x01\x00\xa4\x02" + body[4:],  # WriteResponse
    "a type that does not exist": lambda body: body[: HEAD + 5] + b"\x3e" + body[HEAD + 6 :],
}
HARMLESS: dict[str, Body] = {
    "diagnostics of one result": lambda body: body[:-4] + struct.pack("<i", 2) + b"\x00\x00",
    "no diagnostics, as an empty list": lambda body: body[:-4] + struct.pack("<i", 0),
    "diagnostics of the service": lambda body: body[:20] + b"\x04" + struct.pack("<i", 7) + body[21:],
}


class Spoil:
    """Changes the body of a Read's answer with two results, once `on`; everything else passes."""

    def __init__(self, change: Body) -> None:
        self.on = False
        self.done = 0
        self._change = change

    def __call__(self, data: bytes) -> bytes:
        body = data[CHUNK:]
        if not self.on or data[:4] != b"MSGF" or not body.startswith(TYPE) or body[HEAD : HEAD + 4] != b"\2\0\0\0":
            return data
        self.done += 1
        changed = self._change(body)
        return data[:4] + struct.pack("<I", CHUNK + len(changed)) + data[8:CHUNK] + changed


@pytest.mark.parametrize("path", PATHS[:2])
@pytest.mark.parametrize("wrong", WRONG)
async def test_an_answer_that_does_not_fit_its_request_ends_the_link(asyncua_plc: AsyncuaPlc, path: str, wrong: str):
    spoil = Spoil(WRONG[wrong])
    async with Proxy(asyncua_plc.port) as proxy:
        proxy.spoil = spoil
        tags = [f"ns={asyncua_plc.index};s={name}" for name in ("Plain", "Year9999")]
        with on(path):
            async with opened(f"opc.tcp://127.0.0.1:{proxy.port}", tags, timeout_ms=3000.0) as driver:
                image = Image(2)
                await driver.read(image)
                assert image.values.tolist() == [1.5, 3.5]
                spoil.on, fresh = True, Image(2)
                with pytest.raises(LinkError):
                    await driver.read(fresh)
                assert spoil.done == 1
                assert np.isnan(fresh.values).all()  # nothing of it came through


@pytest.mark.parametrize("path", PATHS[:2])
async def test_diagnostics_that_nobody_asked_for_are_passed_over(asyncua_plc: AsyncuaPlc, path: str):
    for harmless in HARMLESS.values():
        spoil = Spoil(harmless)
        async with Proxy(asyncua_plc.port) as proxy:
            proxy.spoil = spoil
            tags = [f"ns={asyncua_plc.index};s={name}" for name in ("Plain", "Year9999")]
            with on(path):
                async with opened(f"opc.tcp://127.0.0.1:{proxy.port}", tags) as driver:
                    spoil.on, image = True, Image(2)
                    await driver.read(image)
                    assert image.values.tolist() == [1.5, 3.5]
                    assert spoil.done == 1
