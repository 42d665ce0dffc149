"""The register map: places, names, numbers, documents."""

import binascii
import csv
import io
import json

import pytest

from softplc.publishers.modbus.layout import layout
from softplc.publishers.modbus.map import COLUMNS, build_map, render
from softplc.publishers.modbus.offsets import AXIS, SOURCE
from softplc.publishers.modbus.placement import PlacementError, place
from softplc.publishers.modbus.rows import numbered
from softplc.scan import task_tags
from softplc.tags import DataType, Tag, TagTable
from tests.publishers_modbus.support import any_port, full_table, plant


def address_of(table: TagTable, name: str, placements: tuple[tuple[str, int], ...] = ()) -> int:
    return next(row.address for row in layout(table, placements).rows if row.name == name)


def test_every_tag_has_exactly_one_row_and_no_two_rows_share_a_register():
    table = full_table()
    rows = layout(table).rows
    taken = [row.address + word for row in rows for word in range(row.registers)]

    with_register = {tag.name for tag in table if tag.name.rpartition(".")[2] not in AXIS.absent | SOURCE.absent}
    assert with_register <= {row.name for row in rows}
    assert len({row.name for row in rows}) == len(rows)
    assert len(set(taken)) == len(taken)


def test_values_of_two_registers_lie_at_even_addresses():
    assert [row.name for row in layout(full_table()).rows if row.registers > 1 and row.address % 2] == []


def test_every_published_tag_of_a_task_a_source_and_an_axis_has_a_fixed_place():
    """The golden offsets: a change of any of these breaks every screen that was ever made."""
    rows = {row.name: row.address for row in layout(full_table()).rows}
    task = "Heartbeat 0 Alive 1 ScanNumber 2 Overruns 4 Period 10 Dt 12 Jitter 14 ExecutionTime 16 DtP50 20 DtP95 22 \
        DtP99 24 DtMax 26 JitterP50 30 JitterP95 32 JitterP99 34 JitterMax 36 ExecutionP50 40 ExecutionP95 42 \
        ExecutionP99 44 ExecutionMax 46"
    source = "Connected 0 OffScan 1 Reads 2 ReadErrors 4 Reconnects 6 Writes 8 WriteErrors 10 ReadTime 12 Age 14"
    axis = "Position 0 Velocity 2 Raw 4 Innovation 6 S 8 K0 10 K1 12 P00 14 P01 16 P11 18 NIS 20 Dt 22 Age 24 q_x 32 \
        q_x_dot 34 r_x 36 BleedThresh 38 BleedFactor 40 Quality 42 Reason 43 Enabled 44 Enable 45 BleedEnable 46 \
        AgeMs 47 Status 48"
    consistency = " NISMean 28 Outside 30 Autocorrelation 50 Consistency 62"
    header = (
        "CheckWord 0 MapVersion 1 CheckOne 2 CheckNegative 4 MapCrc 6 Heartbeat 7 Axes 8 Tasks 9 Sources 10 Alive 11"
    )

    golden = {}
    blocks = (("", 0, header), ("Tasks.main.", 100, task), ("Sources.plc1.", 1000, source))
    for prefix, start, text in (*blocks, ("AxisX.", 3000, axis + consistency), ("AxisY.", 3064, axis)):
        words = text.split()
        golden |= {prefix + leaf: start + int(offset) for leaf, offset in zip(words[::2], words[1::2], strict=True)}
    assert golden == rows


def test_blocks_of_one_kind_follow_at_equal_distances_in_the_order_of_the_table():
    table = plant(tasks=3, sources=4, axes=5)

    assert [address_of(table, f"Tasks.task{n}.Heartbeat") for n in range(3)] == [100, 200, 300]
    assert [address_of(table, f"Sources.plc{n}.Connected") for n in range(4)] == [1000, 1020, 1040, 1060]
    assert [address_of(table, f"Axis{n}.Position") for n in range(5)] == [3000, 3064, 3128, 3192, 3256]


def test_a_tag_that_is_added_moves_no_other():
    more = TagTable()
    for block in full_table().blocks:
        prefix = block.tags[0].name.rpartition(".")[0]
        added = [Tag(f"{prefix}.New"), Tag(f"{prefix}.Flag", data_type=DataType.BOOLEAN)]
        more.add_block(block.name, block.kind, [*added, *block.tags])
    more.close_section("main")
    before = {row.name: row.address for row in layout(full_table()).rows}
    after = {row.name: row.address for row in layout(more).rows}

    assert before == {name: after[name] for name in before}
    assert [after[f"{block}.New"] for block in ("Tasks.main", "Sources.plc1", "AxisX")] == [150, 1016, 3052]
    assert [after[f"{block}.Flag"] for block in ("Tasks.main", "Sources.plc1", "AxisX")] == [199, 1019, 3063]


def test_a_block_with_more_tags_than_registers_is_refused():
    table = TagTable()
    table.add_block("main", "task", task_tags("main"))
    table.add_block("AxisX", "axis", [Tag(f"AxisX.T{n}") for n in range(8)])
    table.close_section("main")

    with pytest.raises(PlacementError, match=r"AxisX\.T7: no register left in a block of 64"):
        layout(table)


def test_two_values_in_one_register_are_refused():
    table = TagTable()
    table.add_block("main", "task", [Tag("Tasks.main.Heartbeat", data_type=DataType.UINT32)])
    table.close_section("main")

    with pytest.raises(PlacementError, match=r"Tasks\.main\.Heartbeat and Tasks\.main\.Alive share register 101"):
        layout(table)


def test_a_map_without_a_task_has_no_heartbeat_and_is_refused():
    with pytest.raises(PlacementError, match="no task"):
        layout(TagTable())


@pytest.mark.parametrize(
    ("table", "address", "text"),
    [
        (4, 0, "40001"),
        (3, 0, "30001"),
        (4, 3000, "43001"),
        (4, 9998, "49999"),
        (4, 9999, "410000"),
        (3, 9999, "310000"),
        (4, 65535, "465536"),
    ],
)
def test_addresses_are_numbered_from_one_after_the_digit_of_the_table(table: int, address: int, text: str):
    assert text == numbered(table, address)


def test_the_crc_is_that_of_the_exported_addresses_types_and_names():
    table = full_table()
    whole = json.loads(render(build_map(table, any_port()), "json"))
    lines = "".join(f"{row['address']} {row['type']} {row['name']}\n" for row in whole["registers"])

    assert whole["crc"] == binascii.crc_hqx(lines.encode(), 0xFFFF)
    assert whole["crc"] != layout(table, [("AxisX", 5000)]).crc
    assert whole["crc"] == next(row.value for row in layout(table).rows if row.name == "MapCrc")


def test_csv_markdown_and_json_show_the_same_rows():
    register_map = build_map(full_table(), any_port(byte_order="CDAB"))
    from_csv = list(csv.DictReader(io.StringIO(render(register_map, "csv"))))
    from_json = json.loads(render(register_map, "json"))["registers"]
    lines = [line for line in render(register_map, "md").splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    from_md = [row for row in cells if row[0].isdigit()]

    assert list(COLUMNS) == list(from_csv[0]) == list(from_json[0]) == cells[0]
    assert [list(row.values()) for row in from_csv] == [[str(cell) for cell in row.values()] for row in from_json]
    assert [list(row.values()) for row in from_csv] == from_md
    assert {"CDAB"} == {row["order"] for row in from_csv if row["registers"] != "1"}
    assert {""} == {row["order"] for row in from_csv if row["registers"] == "1"}


def test_a_unit_with_a_bar_does_not_break_the_markdown_table():
    table = plant(axes=0)
    table.add_block("AxisX", "axis", [Tag("AxisX.Position", unit="a|b")])

    assert r"| a\|b |" in render(build_map(table, any_port()), "md")


def test_placed_axes_lie_where_they_were_placed_and_the_others_fill_the_free_places_in_order():
    axes = ("A", "B", "C", "D")

    assert place(1, 1, axes, [("B", 3000)]) == {"A": 3064, "B": 3000, "C": 3128, "D": 3192}
    # A at 3100…3163 touches two places of the grid, 3064 and 3128
    assert place(1, 1, axes, [("A", 3100)]) == {"A": 3100, "B": 3000, "C": 3192, "D": 3256}
    assert address_of(plant(), "Axis1.Position", (("Axis1", 3100),)) == 3100


@pytest.mark.parametrize(
    ("placements", "text"),
    [
        ([("AxisX", 3000), ("AxisY", 3032)], "AxisY at 3032…3095 overlaps AxisX at 3000…3063"),
        ([("AxisX", 4000), ("AxisY", 4000)], "AxisY at 4000…4063 overlaps AxisX at 4000…4063"),
        ([("AxisX", 4000), ("AxisX", 5000)], "AxisX is placed twice, at 4000 and at 5000"),
        ([("AxisZ", 4000)], "there is no axis AxisZ; did you mean AxisY?"),
        ([("Pump", 4000)], "there is no axis Pump"),
        ([("AxisX", 2998)], "AxisX at 2998: an axis block begins at 3000…65472; below are header, tasks and sources"),
        ([("AxisX", 65474)], "AxisX at 65474: an axis block begins at 3000…65472"),
        ([("AxisX", 3001)], "AxisX at 3001: expected an even address"),
    ],
)
def test_a_placement_that_cannot_be_says_why(placements: list[tuple[str, int]], text: str):
    with pytest.raises(PlacementError) as caught:
        place(1, 1, ("AxisX", "AxisY"), placements)

    assert text in str(caught.value)
    assert [len(placements) - 1] == [number for number, _ in caught.value.problems]


def test_the_last_place_is_usable():
    assert place(1, 1, ("AxisX",), [("AxisX", 65472)]) == {"AxisX": 65472}
    assert layout(plant(axes=1), [("Axis0", 65472)]).size == 65536


def test_everything_wrong_is_told_at_once():
    with pytest.raises(PlacementError) as caught:
        place(10, 101, ("A", "B"), [("A", 10), ("C", 4000), ("B", 4001)])

    assert [number for number, _ in caught.value.problems] == [None, None, 0, 1, 2]
    assert "10 tasks: the Modbus register map has room for 9" in str(caught.value)
    assert "101 sources: the Modbus register map has room for 100" in str(caught.value)


def test_977_axes_fit_and_978_do_not():
    axes = [f"Axis{n}" for n in range(978)]

    assert place(1, 1, axes[:977])["Axis976"] == 3000 + 976 * 64
    with pytest.raises(PlacementError, match="978 axes: the Modbus register map has room for 977"):
        place(1, 1, axes)


def test_a_large_plant_stays_within_the_address_space():
    register_map = layout(plant(tasks=9, sources=100, axes=977))

    assert register_map.size == 65528
    assert register_map.size == max(section.last for section in register_map.sections) + 1
