"""Where the values of the emulated PLC are, as one types them into a configuration of softplc. Pure."""

from dataclasses import dataclass

from softplc.emulator import modbus_map
from softplc.emulator.scenario import Scenario

_INPUTS = ("Position", "Contact", "y", "y_dot")  # what an observer, its contact and its shadow read


@dataclass(frozen=True, slots=True)
class Place:
    """One value of an axis: `node` over OPC-UA, `address` and `data_type` over Modbus; None where not served."""

    axis: str
    name: str
    node: str | None
    address: str | None
    data_type: str | None


def places(scenario: Scenario) -> list[Place]:
    """Position of every axis, Contact where it has stops, y and y_dot where the PLC runs the AOI."""
    rows = {row.name: row for row in modbus_map.rows(scenario)}
    found = []
    for axis in scenario.axes:
        for name in _INPUTS:
            row = rows.get(f"{axis.name}.{name}")
            if row is None:
                continue
            node = f"ns=2;s={row.name}" if scenario.opcua else None
            address, data_type = (f"{row.table}:{row.offset}", row.data_type) if scenario.modbus else (None, None)
            found.append(Place(axis.name, name, node, address, data_type))
    return found
