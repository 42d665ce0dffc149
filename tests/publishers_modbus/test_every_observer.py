"""Every observer with every tag that an axis may have fits into its block of registers."""

import pytest

from softplc.observers.axes import AxisSpec, axis_tags
from softplc.publishers.modbus.layout import layout
from softplc.publishers.modbus.offsets import AXIS
from softplc.scan import task_tags
from softplc.tags import TagTable
from tests.observers.test_bad_input import OBSERVERS


@pytest.mark.parametrize("name", OBSERVERS)
def test_no_two_tags_share_a_register_and_each_has_a_place_that_is_fixed_or_none(name: str):
    spec = AxisSpec("A", unit="mm", consistency=(200, 5), shadow=("position", "velocity"), tuning_writable=True)
    tags = axis_tags(spec, OBSERVERS[name])
    table = TagTable()
    table.add_block("main", "task", task_tags("main"))
    table.add_block("A", "axis", tags)
    table.close_section("main")

    rows = [row for row in layout(table).rows if row.name.startswith("A.")]  # raises where two share a register

    unplaced = {tag.name.rpartition(".")[2] for tag in tags} - AXIS.offsets.keys() - AXIS.absent
    assert unplaced == set()
    assert max(row.address + row.registers for row in rows) <= 3064
