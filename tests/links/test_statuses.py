"""Status in, status out: every StatusCode of the standard, from a server to the published tags."""

import math
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest
from asyncua import ua

from softplc.drivers.modbus.pdu import Refused
from softplc.sample import Reason, StatusCode, quality
from tests.drivers_opcua.paths import every_path, on
from tests.drivers_opcua.servers import AsyncuaPlc
from tests.links.page import rows
from tests.links.plant import Shown, add, number, plant

STANDARD = {name: code for name, code in vars(ua.StatusCodes).items() if isinstance(code, int) and name[0].isupper()}
LIMITS, OVERFLOW, CONSTANT = 0x0500, 0x0480, 0x0700  # limit low; overflow; high and low: constant
CODES = {
    **STANDARD,
    "GoodLimited": STANDARD["Good"] | LIMITS,
    "GoodConstant": STANDARD["GoodClamped"] | CONSTANT,
    "UncertainLimited": STANDARD["UncertainSensorNotAccurate"] | LIMITS,
    "BadLimited": STANDARD["BadSensorFailure"] | LIMITS,
    "GoodOverflow": OVERFLOW,
    "ReservedSeverity": 0xC0000000,
}
BEFORE, WRONG = 5.0, 13.0
LAST_USABLE = (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)


@pytest.fixture(scope="module")
def plc() -> Iterator[AsyncuaPlc]:
    server = AsyncuaPlc()
    server.run(add(server, list(CODES)))
    yield server
    server.close()


def by_the_page(name: str, code: int) -> tuple[str, str, int]:
    """Estimates, their status and Reason, as docs/status.md says."""
    found = {}
    for inputs, estimates, status, reason in rows("What the outputs make of it"):
        for named in re.findall(r"`(\w+)`", inputs) or [inputs]:
            found[named] = estimates, status, int(reason.split()[0])
    named = next((n for n, c in STANDARD.items() if c == code & 0xFFFF0000), "BadReserved" if code >> 31 else name)
    kind = ("Good", "Uncertain", "Bad", "Bad")[code >> 30]
    return found.get(named) or found.get(f"every {kind} code") or found[f"every other {kind} code"]


def check(name: str, code: int, seen: Shown, reported_once: bool) -> None:
    estimates, status, reason = by_the_page(name, code)
    raw_status = code & ~OVERFLOW if code == OVERFLOW else code
    if reported_once and code & 0xFFFF0000 in LAST_USABLE:
        estimates, status, reason = "held", "UncertainLastUsableValue", Reason.STALE
    expected = {"Good": 0, "the input's": raw_status, "UncertainLastUsableValue": 0x40900000}[status]
    assert (seen.raw_status, seen.status, seen.reason) == (raw_status, expected, reason), name
    assert seen.quality == quality(expected), name
    if code >> 31:
        assert math.isnan(seen.raw), name  # a Bad value is not even shown
        assert math.isnan(seen.position) if estimates == "NaN" else seen.position == pytest.approx(BEFORE), name
    else:
        assert seen.raw == WRONG, name
        # the estimate went from one towards the other, unless it is held
        assert estimates == "held" or BEFORE < seen.position <= WRONG + 4.0, name
    assert (seen.status >> 30 == 0) <= (code >> 30 == 0), name  # Uncertain or Bad is never silently Good


def test_the_list_is_the_standards():
    assert len(STANDARD) > 240
    kinds = [sum(code >> 30 == kind for code in STANDARD.values()) for kind in range(4)]
    assert kinds[0] > 10
    assert kinds[1] > 12
    assert kinds[2] > 200


@every_path
async def test_every_status_of_the_standard_comes_out_as_the_page_says(plc: AsyncuaPlc, path: str):
    stamp = datetime.now(UTC)
    for name in CODES:
        plc.write(name, number(BEFORE, SourceTimestamp=stamp))
    with on(path) as mode:
        async with plant(plc, list(CODES), mode) as axes:
            await axes.until(
                lambda: all(seen.status == 0 for seen in axes.shown.values()) and bool(axes.shown), "Good"
            )
            for name, code in CODES.items():
                plc.write(name, number(WRONG, code, SourceTimestamp=stamp + timedelta(seconds=1)))

            def there(name: str, code: int) -> bool:
                seen = axes.shown[name]
                return seen.raw_status == (0 if code == OVERFLOW else code) and (code >> 31 == 1 or seen.raw == WRONG)

            await axes.until(lambda: all(there(*each) for each in CODES.items()), "every status arrived")
            for _ in range(3):
                await axes.scan()
            for name, code in CODES.items():
                check(name, code, axes.shown[name], reported_once=mode == "subscribe")
            for name in CODES:
                plc.write(name, number(BEFORE, SourceTimestamp=stamp + timedelta(seconds=2)))
            await axes.until(lambda: all(seen.status == 0 for seen in axes.shown.values()), "all are Good again")


def test_modbus_exceptions_have_the_status_of_the_page():
    told: dict[int, str] = {}
    for numbers, status in rows("Modbus exceptions"):
        told |= {int(code): status for code in re.findall(r"\d+", numbers)}
    for code in range(1, 256):
        name = told.get(code, "Bad")
        assert Refused(code).status == (0x80000000 if name == "Bad" else STANDARD[name]), code
