"""ServiceLevel while every task scans, and one of them misses its deadlines."""

from asyncua import Client, ua

from softplc.clock import VirtualClock
from softplc.exchange import Reader, Writer, size
from softplc.publishers.opcua.config import OpcUaPublisher
from softplc.publishers.opcua.server import OpcUaServer
from softplc.sample import StatusCode
from softplc.scan import task_tags
from softplc.tags import Image, TagTable
from softplc.timing import Scan
from tests.support.network import free_port


async def test_a_task_that_misses_its_deadlines_is_a_degraded_service_until_it_keeps_them():
    clock, table = VirtualClock(), TagTable()
    for name in ("fast", "slow"):
        table.add_block(name, "task", task_tags(name))
        table.close_section(name)
    buffer = bytearray(size(table))
    writer, image = Writer(buffer, table), Image(len(table))
    image.values[:], image.statuses[:] = 0.0, StatusCode.GOOD
    server = OpcUaServer(OpcUaPublisher(type="opcua", port=free_port()), Reader(buffer, table, clock))
    url = await server.open()
    levels = []
    try:
        async with Client(url, timeout=30) as client:
            for number, overloaded in enumerate((0.0, 1.0, 1.0, 0.0)):
                image.values[table.index("Tasks.slow.Overloaded")] = overloaded
                for section in (0, 1):
                    writer.publish(section, Scan(number, clock.monotonic(), clock.utc_ns(), 0.1, 0.1, 0), image)
                await server.publish()
                levels.append(await client.get_node(ua.ObjectIds.Server_ServiceLevel).read_value())
                clock.advance(1.1)  # told once a second
    finally:
        await server.close()
    assert levels == [255, 150, 150, 255]
