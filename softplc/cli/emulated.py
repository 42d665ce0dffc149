"""What `softplc emulate` prints when the emulated PLC is ready: its servers, and where its axes are."""

from collections.abc import Sequence
from typing import Any, Final

from softplc.app.supervisor import Endpoints
from softplc.emulator.modbus_map import STRIDE
from softplc.emulator.places import Place, places
from softplc.emulator.scenario import Scenario

_SHOWN: Final = 8  # axes that are listed one by one


def block(title: str, scenario: Scenario, endpoints: Endpoints) -> list[str]:
    """Endpoints, and a line for each value that an axis of a configuration reads."""
    order = scenario.modbus.byte_order if scenario.modbus else "ABCD"
    lines = [title]
    for kind, endpoint in endpoints:
        note = f"   byte_order: {order}" if kind == "modbus" and order != "ABCD" else ""
        lines.append(f"  {kind:<8} {endpoint}{note}")
    shown = {axis.name for axis in scenario.axes[:_SHOWN]}
    lines += _table([place for place in places(scenario) if place.axis in shown])
    more = len(scenario.axes) - len(shown)
    if more:
        apart = f", {STRIDE} registers apart" if scenario.modbus else ""
        lines.append(f"  {'':<8} and {more} more{apart}")
    return [*lines, "Ctrl-C stops"]


def facts(scenario: Scenario, endpoints: Endpoints) -> dict[str, Any]:
    """The same as data, with all axes."""
    axes: dict[str, dict[str, dict[str, str]]] = {}
    for place in places(scenario):
        keys = {"node": place.node, "address": place.address, "data_type": place.data_type}
        axes.setdefault(place.axis, {})[place.name] = {key: word for key, word in keys.items() if word is not None}
    return {**dict(endpoints), "axes": axes}


def _table(found: Sequence[Place]) -> list[str]:
    """Aligned lines: the axis where it begins, then what, node and address, as far as they are served."""
    rows, last = [], ""
    for place in found:
        begins = place.axis != last
        last = place.axis
        address = f"{place.address} {place.data_type}" if place.address else ""
        rows.append(("axis" if begins else "", place.axis if begins else "", place.name, place.node or "", address))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    widths[0] = len("modbus ")
    used = [number for number, width in enumerate(widths) if width]
    return ["  " + "  ".join(row[number].ljust(widths[number]) for number in used).rstrip() for row in rows]
