"""Where the tags of the DUCEKF lie in an axis' block."""

from softplc.observers.axes import AxisSpec, axis_tags
from softplc.observers.ducekf import DucekfConfig, EndStops
from softplc.publishers.modbus.layout import layout
from softplc.publishers.modbus.rows import RegisterType
from softplc.scan import task_tags
from softplc.tags import TagTable


def test_every_tag_has_its_fixed_place_and_none_shares_a_register():
    stops = DucekfConfig(type="ducekf", r_x=1.0, model=EndStops(type="end_stops", lower=0.0, upper=1.0))
    table = TagTable()
    table.add_block("main", "task", task_tags("main"))
    table.add_block("A", "axis", axis_tags(AxisSpec("A", unit="mm"), stops))
    table.close_section("main")

    rows = {row.name.removeprefix("A."): row for row in layout(table).rows if row.name.startswith("A.")}

    places = {
        "Impacts": 26,
        "q_x": 32,
        "Band": 38,
        "Restitution": 40,
        "Contact": 46,
    }
    assert {leaf: rows[leaf].address - 3000 for leaf in places} == places
    assert rows["Impacts"].type is RegisterType.UINT32
    used = [address for row in rows.values() for address in range(row.address, row.address + row.type.registers)]
    assert len(used) == len(set(used))
