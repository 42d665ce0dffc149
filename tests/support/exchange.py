"""A hand-made tag table with one task, one source and two axes, and an exchange over plain memory."""

from dataclasses import dataclass

from softplc.clock import Clock, VirtualClock
from softplc.exchange import Reader, Writer, size
from softplc.observers.aoi import AoiConfig, Bleed
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.sample import StatusCode
from softplc.tags import DataType, Image, Tag, TagTable
from softplc.timing import Scan

AXES = (
    AxisSpec("AxisX", unit="mm", range=(-500.0, 500.0), consistency=(200, 5)),
    AxisSpec("AxisY", unit="deg", enable_writable=True, tuning_writable=True),
)
OBSERVER = AoiConfig(type="aoi", r_x=4 / 3, bleed=Bleed(threshold=0.5, factor=0.9))


def make_table() -> TagTable:
    """Blocks main (task), plc1 (source), AxisX, AxisY (axes); one section."""
    table = TagTable()
    table.add_block(
        "main",
        "task",
        [
            Tag("Tasks.main.Heartbeat", "", "Counts scans, rolls over at 65535", data_type=DataType.UINT16),
            Tag("Tasks.main.ScanNumber", "", "Scans since start", data_type=DataType.UINT32),
            Tag("Tasks.main.Dt", "s", "Measured scan interval"),
        ],
    )
    table.add_block(
        "plc1",
        "source",
        [
            Tag("Sources.plc1.Connected", "", "The link is up", data_type=DataType.BOOLEAN),
            Tag("Sources.plc1.ReadErrors", "", "Failed reads since start", data_type=DataType.UINT32),
        ],
    )
    for spec in AXES:
        table.add_block(spec.name, "axis", axis_tags(spec, OBSERVER))
    table.close_section("main")
    return table


@dataclass
class Exchange:
    """Both ends over one buffer, and the image that the writer publishes."""

    table: TagTable
    image: Image
    writer: Writer
    reader: Reader
    clock: Clock
    buffer: bytearray
    scans: int = 0

    def set(self, name: str, value: float, status: int = StatusCode.GOOD, stamp: int | None = None) -> None:
        """Put one tag's sample into the image; `publish` sends it."""
        index = self.table.index(name)
        self.image.values[index] = value
        self.image.statuses[index] = status
        self.image.source_timestamps[index] = self.clock.utc_ns() if stamp is None else stamp

    def publish(self, period: float = 0.05) -> Scan:
        """One more scan, now."""
        self.scans += 1
        self.set("Tasks.main.Heartbeat", self.scans % 65536)
        scan = Scan(self.scans, self.clock.monotonic(), self.clock.utc_ns(), period, period, 0)
        self.writer.publish(0, scan, self.image)
        return scan


def make_exchange(clock: Clock | None = None) -> Exchange:
    """An exchange whose every tag is Good and equal to its index, not yet published."""
    clock = clock or VirtualClock()
    table = make_table()
    buffer = bytearray(size(table))
    exchange = Exchange(table, Image(len(table)), Writer(buffer, table), Reader(buffer, table, clock), clock, buffer)
    for index, tag in enumerate(table):
        exchange.set(tag.name, float(index))
    return exchange
