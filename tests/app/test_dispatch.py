"""Commands as a gateway that a stranger took over may put them: raw bytes in the shared memory."""

import math
import struct

import numpy as np
import structlog
from hypothesis import example, given
from hypothesis import strategies as st

from softplc.app.dispatch import Commands, refusal
from softplc.clock import VirtualClock
from softplc.exchange import COMMANDS, Pulse, Reader, Writer
from softplc.tags import Image, Tag
from tests.support.exchange import make_exchange

HEAD, TAIL = 2 * 8, 3 * 8
INT64 = st.integers(-(2**63), 2**63 - 1)


class Observer:
    """Takes everything, and notes it."""

    def __init__(self):
        self.taken = []

    def command(self, index, value):
        self.taken.append((index, value))
        return True


def dispatcher(exchange, writer):
    observer = Observer()
    commands = Commands(exchange.table, Image(len(exchange.table)), writer, exchange.clock)
    commands.tasks = [type("Task", (), {"observers": [observer]})()]
    return commands, observer


def ring(exchange):
    """Offset of the indices and of the values in the shared memory."""
    memory = exchange.writer._memory
    base = np.frombuffer(exchange.buffer, np.uint8).__array_interface__["data"][0]
    return [array.__array_interface__["data"][0] - base for array in (memory.command_index, memory.command_value)]


@given(
    head=INT64 | st.integers(-COMMANDS - 1, COMMANDS + 1),
    tail=INT64 | st.integers(-COMMANDS - 1, COMMANDS + 1),
    slots=st.lists(st.tuples(INT64 | st.integers(-5, 120), st.floats(width=64)), max_size=COMMANDS),
)
@example(head=2**63 - 1, tail=0, slots=[])
@example(head=-(2**63), tail=2**63 - 1, slots=[])
@example(head=COMMANDS - 1, tail=0, slots=[(50, math.nan)] * COMMANDS)
def test_whatever_bytes_the_ring_holds_only_values_that_the_tags_allow_reach_an_observer(head, tail, slots):
    exchange = make_exchange(VirtualClock())
    commands, observer = dispatcher(exchange, exchange.writer)
    indices, values = ring(exchange)
    for number, (index, value) in enumerate(slots):
        struct.pack_into("<q", exchange.buffer, indices + 8 * number, index)
        struct.pack_into("<d", exchange.buffer, values + 8 * number, value)
    struct.pack_into("<q", exchange.buffer, HEAD, head)
    struct.pack_into("<q", exchange.buffer, TAIL, tail)

    for _ in range(3):
        commands.dispatch()
        exchange.publish()

    waiting = head if 0 <= head < COMMANDS else 0  # the scan process knows itself where it is: at 0
    assert len(observer.taken) + commands.refused == (waiting if head == waiting else 1)
    for index, value in observer.taken:
        tag = exchange.table.tags[index]
        assert tag.writable
        assert refusal(tag, value) == ""
    # the next command of a sound gateway arrives, whatever is left there
    sound = exchange.table.index("AxisY.Enable")
    assert Reader(exchange.buffer, exchange.table, exchange.clock).command(sound, 1.0) or head == COMMANDS - 1
    commands.dispatch()
    assert observer.taken[-1:] == [(sound, 1.0)] or head == COMMANDS - 1


@given(head=INT64, tail=INT64, sequence=INT64)
def test_a_scan_process_that_starts_over_ruins_publishes_and_takes_commands(head, tail, sequence):
    exchange = make_exchange(VirtualClock())
    struct.pack_into("<q", exchange.buffer, HEAD, head)
    struct.pack_into("<q", exchange.buffer, TAIL, tail)
    struct.pack_into("<q", exchange.buffer, 8 * 8, sequence)
    exchange.writer = Writer(exchange.buffer, exchange.table)
    commands, observer = dispatcher(exchange, exchange.writer)

    commands.dispatch()
    exchange.publish()
    reader = Reader(exchange.buffer, exchange.table, exchange.clock)
    assert reader.snapshot().alive == (True,)
    before = Pulse(exchange.buffer, exchange.table).scan(0)
    exchange.publish()
    assert Pulse(exchange.buffer, exchange.table).scan(0) != before

    index = exchange.table.index("AxisY.Enable")
    assert reader.command(index, 0.0)
    commands.dispatch()
    assert (index, 0.0) in observer.taken


def test_each_kind_of_wrong_value_is_refused_with_its_reason():
    limited = Tag("A.q_x", writable=True, limits=(0.0, 1.0))
    assert refusal(limited, 0.5) == ""
    assert refusal(limited, 1.5) == "outside 0 … 1"
    assert refusal(limited, math.nan) == refusal(limited, math.inf) == "not finite"
    assert refusal(Tag("A.Position"), 0.5) == "not writable"


def test_refused_commands_are_counted_and_told_a_few_times_a_minute():
    exchange = make_exchange(VirtualClock())
    commands, observer = dispatcher(exchange, exchange.writer)
    with structlog.testing.capture_logs() as lines:
        for _ in range(100):
            exchange.reader.command(exchange.table.index("AxisX.Position"), 1.0)
            exchange.reader.command(10**9, 1.0)
            commands.dispatch()
    assert commands.refused == 200
    assert observer.taken == []
    assert [line["reason"] for line in lines[:2]] == ["not writable", "no such tag"]
    assert len(lines) == 6


def test_an_observer_that_raises_at_a_command_loses_that_command_alone():
    exchange = make_exchange(VirtualClock())
    commands, observer = dispatcher(exchange, exchange.writer)
    sound = observer.command
    observer.command = lambda index, value: sound(index, value) if value else 1 / 0
    index = exchange.table.index("AxisY.Enable")
    with structlog.testing.capture_logs() as lines:
        for value in (1.0, 0.0, 1.0):
            exchange.reader.command(index, value)
        commands.dispatch()
    assert observer.taken == [(index, 1.0), (index, 1.0)]
    assert commands.refused == 1
    assert "ZeroDivisionError" in next(line for line in lines if line["event"] == "command refused")["reason"]
