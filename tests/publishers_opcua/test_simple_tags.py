"""The baselines and cv_accel as an OPC-UA client finds them: every tag readable, with its unit and type."""

from asyncua import Client

from softplc.clock import VirtualClock
from softplc.exchange import Reader, Writer, size
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.publishers.opcua.config import OpcUaPublisher
from softplc.publishers.opcua.server import OpcUaServer
from softplc.sample import WRITE_STATE_TEXT, WriteState
from softplc.scan import task_tags
from softplc.tags import DataType, Image, TagTable
from tests.observers.simple import CASES
from tests.support.exchange import Exchange
from tests.support.network import free_port


async def test_a_client_reads_every_tag_of_every_observer_with_its_unit():
    clock, table = VirtualClock(), TagTable()
    table.add_block("main", "task", task_tags("main"))
    for number, case in enumerate(CASES):
        spec = AxisSpec(f"A{number}", unit="mm" if number % 2 else "", writes=True)
        table.add_block(spec.name, "axis", axis_tags(spec, case.configs[0]))
    table.close_section("main")
    buffer = bytearray(size(table))
    exchange = Exchange(table, Image(len(table)), Writer(buffer, table), Reader(buffer, table, clock), clock, buffer)
    for index, tag in enumerate(table):
        exchange.set(tag.name, float(index))
    exchange.publish()
    server = OpcUaServer(OpcUaPublisher(type="opcua", port=free_port()), exchange.reader, None)
    url = await server.open()
    try:
        async with Client(url, timeout=20) as client:
            for index, tag in enumerate(table):
                if not tag.name.startswith("A"):
                    continue
                node = client.get_node(f"ns=2;s={tag.name}")
                value = await node.read_value()
                assert value == (index != 0 if tag.data_type is DataType.BOOLEAN else index), tag.name
                if tag.data_type is DataType.DOUBLE and tag.unit:
                    unit = await (await node.get_child("0:EngineeringUnits")).read_value()
                    assert unit.DisplayName.Text == tag.unit, tag.name
            texts = await client.get_node("ns=2;s=A0.WriteState.EnumStrings").read_value()
            assert [text.Text for text in texts] == [WRITE_STATE_TEXT[state] for state in WriteState]
    finally:
        await server.close()
