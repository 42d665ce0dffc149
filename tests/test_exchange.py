import multiprocessing
import threading

import numpy as np

from softplc.clock import VirtualClock
from softplc.exchange import COMMANDS, Reader, Writer, size
from softplc.sample import StatusCode
from softplc.tags import Image, Tag, TagTable
from softplc.timing import Scan
from tests.support.exchange import make_exchange


def test_the_reader_sees_what_was_published_value_status_and_timestamp():
    exchange = make_exchange()
    exchange.set("AxisX.Position", 12.5, StatusCode.UNCERTAIN_LAST_USABLE_VALUE, stamp=123456789)
    scan = exchange.publish()

    snapshot = exchange.reader.snapshot()

    index = exchange.table.index("AxisX.Position")
    assert snapshot.values[index] == 12.5
    assert snapshot.statuses[index] == StatusCode.UNCERTAIN_LAST_USABLE_VALUE
    assert snapshot.source_timestamps[index] == 123456789
    assert snapshot.scans == (scan,)
    assert snapshot.alive == (True,)


def test_before_the_first_scan_every_tag_waits_for_initial_data():
    snapshot = make_exchange().reader.snapshot()
    assert snapshot.scans == (None,)
    assert (snapshot.statuses == StatusCode.BAD_WAITING_FOR_INITIAL_DATA).all()
    assert np.isnan(snapshot.values).all()


def test_nothing_new_is_the_same_snapshot_object():
    exchange = make_exchange()
    exchange.publish()
    first = exchange.reader.snapshot()
    assert exchange.reader.snapshot() is first
    exchange.publish()
    assert exchange.reader.snapshot().version == first.version + 1


def test_a_task_that_stops_scanning_has_bad_tags_and_comes_back_good():
    exchange = make_exchange()
    exchange.publish(period=0.1)
    exchange.reader.snapshot()

    exchange.clock.advance(0.31)  # more than three periods
    dead = exchange.reader.snapshot()
    assert dead.alive == (False,)
    assert (dead.statuses == StatusCode.BAD_NO_COMMUNICATION).all()
    assert np.isnan(dead.values).all()

    exchange.publish(period=0.1)
    back = exchange.reader.snapshot()
    assert back.alive == (True,)
    assert (back.statuses == StatusCode.GOOD).all()


def test_a_reader_that_starts_after_the_task_died_sees_bad_tags_not_the_last_good_ones():
    exchange = make_exchange()
    exchange.publish(period=0.1)
    exchange.clock.advance(5.0)
    late = Reader(exchange.buffer, exchange.table, exchange.clock).snapshot()
    assert late.alive == (False,)
    assert (late.statuses == StatusCode.BAD_NO_COMMUNICATION).all()
    assert np.isnan(late.values).all()


def test_snapshots_are_read_only():
    exchange = make_exchange()
    exchange.publish()
    assert not exchange.reader.snapshot().values.flags.writeable


def test_commands_arrive_in_order_once():
    exchange = make_exchange()
    for k in range(5):
        assert exchange.reader.command(k, k / 2)
    assert exchange.writer.commands() == [(k, k / 2) for k in range(5)]
    assert exchange.writer.commands() == []


def test_a_full_command_ring_refuses_and_loses_nothing():
    exchange = make_exchange()
    taken = [exchange.reader.command(1, float(k)) for k in range(2 * COMMANDS)]
    assert taken.count(True) == COMMANDS - 1
    assert [value for _, value in exchange.writer.commands()] == [float(k) for k in range(COMMANDS - 1)]
    assert exchange.reader.command(1, 0.0)


def test_a_writer_that_died_half_way_is_taken_over_by_the_next():
    clock = VirtualClock()
    table = TagTable()
    table.add_block("main", "task", [Tag("Tasks.main.Heartbeat")])
    table.close_section("main")
    buffer = bytearray(size(table))
    Writer(buffer, table).publish(0, Scan(1, 0.0, 0, 0.1, 0.1, 0), Image(1))
    sequence = np.frombuffer(buffer, np.int64, 1, 8 * 8)
    sequence[0] += 1  # as left behind by a process killed within publish

    reader = Reader(buffer, table, clock)
    assert reader.snapshot().scans == (None,)
    image = Image(1)
    image.values[0] = 7.0
    Writer(buffer, table).publish(0, Scan(2, 0.0, 0, 0.1, 0.1, 0), image)
    assert reader.snapshot().values[0] == 7.0


_N = 2000


def _wide_table() -> TagTable:
    table = TagTable()
    table.add_block("main", "task", [Tag(f"T{k}") for k in range(_N)])
    table.close_section("main")
    return table


def _publish_equal_values(buffer, enough) -> None:
    table = _wide_table()
    writer, image = Writer(buffer, table), Image(_N)
    k = 0
    while not enough.is_set():
        k += 1
        image.values[:] = k
        image.source_timestamps[:] = k
        writer.publish(0, Scan(k, 0.0, 0, 0.1, 0.1, 0), image)


def _read_equal_values(reader, writer_lives, different) -> None:
    """Read until so many different snapshots were seen, each whole."""
    seen = set()
    while len(seen) < different and writer_lives():
        snapshot = reader.snapshot()
        if snapshot.scans[0] is not None:
            assert len(np.unique(snapshot.values)) == 1
            assert snapshot.values[0] == snapshot.source_timestamps[-1] == snapshot.scans[0].number
            seen.add(snapshot.scans[0].number)
    assert len(seen) == different, "the writer ended first"


def test_a_snapshot_is_never_torn_while_another_process_publishes_at_full_speed():
    spawn = multiprocessing.get_context("spawn")
    buffer, enough = spawn.RawArray("b", size(_wide_table())), spawn.Event()
    process = spawn.Process(target=_publish_equal_values, args=(buffer, enough))
    process.start()
    try:
        _read_equal_values(Reader(buffer, _wide_table(), VirtualClock()), process.is_alive, different=300)
    finally:
        enough.set()
        process.join(60)
    assert process.exitcode == 0


def test_the_fence_works_across_threads_too():
    buffer, enough = bytearray(size(_wide_table())), threading.Event()
    thread = threading.Thread(target=_publish_equal_values, args=(buffer, enough))
    thread.start()
    try:
        _read_equal_values(Reader(buffer, _wide_table(), VirtualClock()), thread.is_alive, different=20)
    finally:
        enough.set()
        thread.join(60)
    assert not thread.is_alive()
