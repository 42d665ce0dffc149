import json

from softplc.app.layout import build_layout
from softplc.config.models import Config


def config(**changes):
    data = {
        "tasks": [{"name": "fast", "period_ms": 10}, {"name": "slow", "period_ms": 100}, {"name": "idle"}],
        "sources": [
            {"name": "plc", "type": "opcua", "url": "opc.tcp://127.0.0.1:4841"},
            {"name": "drive", "type": "modbus", "transport": {"type": "tcp", "host": "127.0.0.1"}},
        ],
        "axes": [
            {
                "name": "A",
                "input": {"source": "plc", "node": "ns=2;s=A"},
                "enable": {"source": "plc", "node": "ns=2;s=Run"},
                "observer": {"type": "aoi", "r_x": 1.0},
            },
            {
                "name": "B",
                "input": {"source": "plc", "node": "ns=2;s=B"},
                "enable": {"source": "plc", "node": "ns=2;s=Run"},
                "observer": {"type": "aoi", "r_x": 1.0, "precision": "real"},
                "write_back": [{"output": "Velocity", "tag": {"source": "plc", "node": "ns=2;s=V"}}],
            },
            {
                "name": "C",
                "task": "slow",
                "input": {"source": "drive", "address": 40001},
                "enable": {"writable": True, "initial": False},
                "observer": {"type": "aoi", "r_x": 1.0},
            },
        ],
        **changes,
    }
    return Config.model_validate_json(json.dumps(data))


def test_each_task_with_axes_is_one_section_of_the_table():
    layout = build_layout(config())
    assert [name for name, _, _ in layout.table.sections] == ["fast", "slow"]
    assert layout.table.sections[-1][2] == len(layout.table)
    assert [block.name for block in layout.table.blocks] == ["fast", "plc", "A", "B", "slow", "drive", "C"]


def test_the_same_configuration_gives_the_same_indices():
    one, two = build_layout(config()).table, build_layout(config()).table
    assert [tag.name for tag in one] == [tag.name for tag in two]


def test_two_axes_may_share_an_enable_tag_and_it_is_read_once():
    fast = build_layout(config()).tasks[0]
    (plc,) = fast.sources
    assert plc.reading_names == ["A.Raw", "A.Enable", "B.Raw"]
    places = [place for group in fast.observers for place in group.places]
    assert {place.enable for place in places} == {1}


def test_axes_of_different_precision_are_different_groups():
    fast = build_layout(config()).tasks[0]
    assert [[place.spec.name for place in group.places] for group in fast.observers] == [["A"], ["B"]]


def test_write_back_points_from_the_published_tag_to_the_sources_writing():
    layout = build_layout(config())
    (write_back,) = layout.tasks[0].write_backs
    assert layout.table.tags[write_back.index].name == "B.Velocity"
    assert (write_back.source, write_back.position) == ("plc", 0)
    assert layout.tasks[0].sources[0].writing_names == ["B.Velocity"]


def test_a_writable_enable_is_a_writable_tag_with_its_initial_state():
    layout = build_layout(config())
    tags = {tag.name: tag for tag in layout.table}
    assert tags["C.Enable"].writable
    assert not tags["A.Enable"].writable
    assert [place.spec.enable for group in layout.tasks[1].observers for place in group.places] == [False]
