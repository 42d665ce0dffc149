"""Which process is stuck, and which was only held up with everybody else."""

import asyncio
import os
import signal
import time
from concurrent.futures import Future

import structlog

from softplc.app.guard import Guard, Sign, guard
from softplc.app.process import SPAWN, Child
from softplc.clock import SystemClock
from tests.support.network import eventually


class Stub:
    """A child as the guard sees it."""

    def __init__(self):
        self.process = object()
        self.ready = Future()


def guarded(limit=5.0):
    child, count = Stub(), [0]
    child.ready.set_result(("ready", {}))
    return Guard(child, [Sign("no scan", lambda: count[0], limit)]), child, count


def test_a_counter_that_stands_still_for_longer_than_the_limit_is_missing():
    watch, _, _ = guarded()
    found = [watch.look(0.5) for _ in range(13)]
    assert found[:11] == [None] * 11
    assert found[11] == ("no scan", 5.5)


def test_a_counter_that_moves_just_in_time_is_not():
    watch, _, count = guarded()
    for number in range(100):
        count[0] += number % 10 == 0
        assert watch.look(0.5) is None


def test_a_guard_that_slept_for_an_hour_holds_nobody_to_account_for_it():
    watch, _, count = guarded()
    watch.look(0.5)
    assert watch.look(3600.0) is None
    count[0] += 1
    assert watch.look(3600.0) is None


def test_a_new_process_has_its_own_time_and_one_that_never_is_ready_is_stuck_too():
    watch, child, _ = guarded()
    for _ in range(10):
        watch.look(0.5)
    child.process = object()
    assert watch.look(0.5) is None
    child.ready, child.process = Stub().ready, object()
    found = [watch.look(1.0) for _ in range(122)]
    assert found[118] is None
    assert found[121][0] == "it is not ready"


def blocks_after_a_while(counter, connection):
    """An event loop that turns, until a callback does not return."""

    async def run():
        connection.send(("ready", {}))
        for _ in range(5):
            counter[0] += 1
            await asyncio.sleep(0.02)
        time.sleep(600.0)

    asyncio.run(run())


def turns(counter, connection):
    async def run():
        connection.send(("ready", {}))
        while True:
            counter[0] += 1
            await asyncio.sleep(0.02)

    asyncio.run(run())


async def test_an_event_loop_that_a_callback_blocks_is_killed_and_told_and_one_that_turns_is_not():
    clock = SystemClock()
    counters = [SPAWN.RawArray("q", 1) for _ in range(2)]
    stuck, well = Child("stuck", blocks_after_a_while, (counters[0],)), Child("well", turns, (counters[1],))
    guards = [
        Guard(child, [Sign("its event loop does not turn", lambda counter=counter: counter[0], 2.0)])
        for child, counter in zip((stuck, well), counters, strict=True)
    ]
    for child in (stuck, well):
        child.start(clock.monotonic())
    guarding = asyncio.create_task(guard(guards, clock))
    try:
        with structlog.testing.capture_logs() as lines:
            async with asyncio.timeout(60):
                assert await stuck.ended() == -signal.SIGKILL
        told = [line for line in lines if line["event"] == "process stuck, killed"]
        assert [(line["child"], line["what"]) for line in told] == [("stuck", "its event loop does not turn")]
        os.kill(well.process.pid, signal.SIGSTOP)  # for less than the limit
        await asyncio.sleep(0.5)
        os.kill(well.process.pid, signal.SIGCONT)
        before = counters[1][0]
        await eventually(lambda: counters[1][0] > before + 5)
        assert well.alive
    finally:
        guarding.cancel()
        await stuck.stop()
        await well.stop()
        clock.close()
