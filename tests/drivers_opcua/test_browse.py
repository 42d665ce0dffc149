"""What a person who writes a configuration gets to see of a server, and the block that can be pasted."""

import asyncio
import time

import pytest
from ruamel.yaml import YAML

from softplc.config.models import Config
from softplc.drivers.opcua.browse import Variable, browse, yaml_block
from softplc.errors import LinkError
from softplc.sample import StatusCode
from tests.drivers_opcua.opened import opened, read
from tests.drivers_opcua.servers import NUMBERS, STAMP_NS, AsyncuaPlc, NodePlc
from tests.support.network import eventually, free_port


async def test_every_variable_is_listed_with_address_type_value_status_and_access(plc: NodePlc):
    listing = await browse(plc.url)
    found = {variable.path.rpartition(":")[2]: variable for variable in listing.variables}

    assert listing.complete
    for name, number in NUMBERS.items():
        variable = found[name]
        assert float(variable.value) == number
        assert variable.data_type == ("Boolean" if name == "Bool" else name)
        assert variable.is_number == (name != "Bool")
    assert found["Doubles"] == Variable(
        path="/Objects/2:PLC/2:Axis/2:Doubles",
        node="ns=2;s=PLC.Axis.Doubles",
        node_by_uri="nsu=urn:softplc:test:plc;s=PLC.Axis.Doubles",
        data_type="Double",
        length=3,
        value=[10.5, 11.5, 12.5],
        status=0,
        source_timestamp=STAMP_NS,
        readable=True,
        writable=True,
        is_number=True,
    )
    assert (found["Bad"].value, found["Bad"].status) == (None, StatusCode.BAD_SENSOR_FAILURE)
    assert (found["Uncertain"].value, found["Uncertain"].status) == (14.0, StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)
    assert (found["Text"].value, found["Text"].is_number) == ("seven", False)
    assert (found["Secret"].readable, found["ReadOnly"].readable, found["ReadOnly"].writable) == (False, True, False)


async def test_the_servers_own_nodes_are_listed_only_when_asked_for(plc: NodePlc):
    usual = await browse(plc.url)
    everything = await browse(plc.url, server_nodes=True)

    assert not any("ServerStatus" in variable.path for variable in usual.variables)
    status = next(one for one in everything.variables if one.path.endswith("/ServerStatus/CurrentTime"))
    assert (status.node, status.node_by_uri) == ("i=2258", "i=2258")
    assert len(everything.variables) > 100


@pytest.mark.parametrize(
    ("only", "names"), [("axis/2:fl", {"Flag", "Float"}), ("*:Int??", {"Int16", "Int32", "Int64"})]
)
async def test_a_filter_picks_by_part_of_the_path_or_by_pattern(plc: NodePlc, only: str, names: set[str]):
    listing = await browse(plc.url, only=only)

    assert {variable.path.rpartition(":")[2] for variable in listing.variables} == names


async def test_a_filter_picks_by_part_of_the_node_id_as_well(plc: NodePlc):
    (float_, *_) = (await browse(plc.url, only="axis/2:float")).variables

    found = await browse(plc.url, only=float_.node.partition(";")[2].upper())

    assert float_.node in {variable.node for variable in found.variables}


async def test_bounds_end_the_search_and_it_is_told(plc: NodePlc):
    few = await browse(plc.url, max_nodes=10)
    flat = await browse(plc.url, max_depth=2)

    assert (len(few.variables) <= 10, few.complete) == (True, False)
    assert (flat.variables, flat.complete) == ((), False)


async def test_more_references_than_one_answer_takes_are_all_listed(plc: NodePlc):
    at_once = await browse(plc.url)
    by_threes = await browse(plc.url, page=3)

    assert [variable.path for variable in by_threes.variables] == [variable.path for variable in at_once.variables]


async def test_another_implementations_server_is_listed_too(asyncua_plc: AsyncuaPlc):
    listing = await browse(asyncua_plc.url)
    found = {variable.node: variable for variable in listing.variables}

    assert found[f"ns={asyncua_plc.index};s=Plain"].value == 1.5
    assert found[f"ns={asyncua_plc.index};s=Empty"].is_number  # by its declared type


async def test_the_block_is_a_valid_configuration_and_its_tags_read(plc: NodePlc):
    listing = await browse(plc.url, only="/2:Axis/")
    config = Config.model_validate(
        {key: _tuples(value) for key, value in YAML(typ="safe").load(yaml_block(plc.url, listing.variables)).items()}
    )

    names = [axis.name for axis in config.axes]
    assert len(names) == len(set(names))
    assert {"Ramp", "Int16", "Doubles"} <= set(names)
    assert not {"Flag", "Text", "Secret"} & set(names)  # a Boolean, a text, not readable
    tags = [axis.input for axis in config.axes]
    plain = [tag.node if tag.index is None else (tag.node, tag.index) for tag in tags]
    async with opened(plc.url, plain) as driver:
        assert not driver.problems
        image = await read(driver, len(tags))
        assert image.values[names.index("Doubles")] == 10.5


def _tuples(value: object) -> object:
    """The models are strict: a YAML sequence goes where a tuple is asked for."""
    return tuple(value) if isinstance(value, list) else value


def test_names_in_the_block_are_told_apart_by_what_is_above_them():
    def variable(path: str) -> Variable:
        return Variable(path, "ns=2;i=1", "nsu=urn:a;i=1", "Double", None, 0.0, 0, None, True, False, True)

    paths = ["/Objects/2:X/2:Position", "/Objects/2:Y/2:Position", "/Objects/2:Z/2:3rd axis, left", "/Objects/2:Same"]
    block = yaml_block("opc.tcp://h:4840", [variable(path) for path in [*paths, paths[-1]]])

    names = [axis["name"] for axis in YAML(typ="safe").load(block)["axes"]]
    assert names == ["X_Position", "Y_Position", "_3rd_axis_left", "Same_1", "Same_2"]


def test_a_block_without_numbers_says_so():
    assert YAML(typ="safe").load(yaml_block("opc.tcp://h:4840", []))["axes"] == []


async def silence(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read()
    writer.close()


async def test_browsing_leaves_nothing_behind_and_a_silent_server_ends_it_in_time(plc: NodePlc):
    tasks = len(asyncio.all_tasks())
    await browse(plc.url, only="Float")
    await eventually(lambda: len(asyncio.all_tasks()) == tasks)

    server = await asyncio.start_server(silence, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    started = time.monotonic()
    with pytest.raises(LinkError, match="no answer"):
        await browse(f"opc.tcp://127.0.0.1:{port}", timeout=0.3)
    assert time.monotonic() - started < 15.0  # the limit of all of it is 120 s
    server.close()

    with pytest.raises(LinkError, match="cannot connect"):
        await browse(f"opc.tcp://127.0.0.1:{free_port()}")
