"""Engineering units that an axis may have: symbol, UNECE code, and the unit of its velocity."""

from dataclasses import dataclass
from typing import Final

UNECE_NAMESPACE: Final = "http://www.opcfoundation.org/UA/units/un/cefact"


@dataclass(frozen=True, slots=True)
class Unit:
    """One unit: `code` is the UNECE Recommendation 20 common code, None where UNECE has none."""

    symbol: str
    name: str
    code: str | None

    @property
    def unit_id(self) -> int:
        """The OPC UA EUInformation.UnitId: the code's characters as one big-endian number (OPC 10000-8, 5.6.3)."""
        if self.code is None:
            return -1
        return int.from_bytes(self.code.encode("ascii"), "big")


_TABLE: Final = (
    Unit("", "one", "C62"),
    Unit("%", "percent", "P1"),
    Unit("m", "metre", "MTR"),
    Unit("mm", "millimetre", "MMT"),
    Unit("cm", "centimetre", "CMT"),
    Unit("µm", "micrometre", "4H"),
    Unit("km", "kilometre", "KMT"),
    Unit("in", "inch", "INH"),
    Unit("ft", "foot", "FOT"),
    Unit("rad", "radian", "C81"),
    Unit("deg", "degree", "DD"),
    Unit("rev", "revolution", "M44"),
    Unit("count", "count", None),
    Unit("m/s", "metre per second", "MTS"),
    Unit("mm/s", "millimetre per second", "C16"),
    Unit("cm/s", "centimetre per second", "2M"),
    Unit("km/h", "kilometre per hour", "KMH"),
    Unit("in/s", "inch per second", "IU"),
    Unit("ft/s", "foot per second", "FS"),
    Unit("rad/s", "radian per second", "2A"),
    Unit("deg/s", "degree per second", "E96"),
    Unit("rev/s", "revolution per second", "RPS"),
    Unit("r/min", "revolutions per minute", "RPM"),
    Unit("1/s", "reciprocal second", "C97"),
    Unit("mm2", "square millimetre", "MMK"),
    Unit("m2", "square metre", "MTK"),
    Unit("in2", "square inch", "INK"),
    Unit("mm2/s", "square millimetre per second", "C17"),
    Unit("m2/s", "square metre per second", "S4"),
    Unit("s", "second", "SEC"),
    Unit("ms", "millisecond", "C26"),
    Unit("°C", "degree Celsius", "CEL"),
    Unit("bar", "bar", "BAR"),
    Unit("l", "litre", "LTR"),
    Unit("kg", "kilogram", "KGM"),
    Unit("N", "newton", "NEW"),
)
UNITS: Final[dict[str, Unit]] = {unit.symbol: unit for unit in _TABLE}


def unit(symbol: str) -> Unit:
    """The unit of a symbol; one that UNECE does not know keeps its symbol and has no code."""
    return UNITS.get(symbol) or Unit(symbol, symbol, None)


def per_second(symbol: str) -> str:
    """Symbol of a unit's rate: mm becomes mm/s, a dimensionless one 1/s."""
    return f"{symbol}/s" if symbol else "1/s"


def squared(symbol: str) -> str:
    """Symbol of a unit's square: mm becomes mm2, mm/s becomes (mm/s)2."""
    if not symbol:
        return ""
    return f"({symbol})2" if "/" in symbol else f"{symbol}2"
