import asyncio

from softplc.clock import SystemClock, VirtualClock


async def test_virtual_time_moves_to_the_next_deadline_when_everyone_sleeps():
    clock = VirtualClock()
    woken = []

    async def sleeper(name, period, n):
        for k in range(1, n + 1):
            await clock.sleep_until(k * period)
            woken.append((clock.monotonic(), name))

    await asyncio.gather(sleeper("slow", 0.2, 2), sleeper("fast", 0.1, 4))

    assert [t for t, _ in woken] == sorted(t for t, _ in woken)
    assert [round(t, 3) for t, _ in woken] == [0.1, 0.2, 0.2, 0.3, 0.4, 0.4]
    assert [name for _, name in woken].count("slow") == 2


async def test_of_those_due_together_the_highest_priority_wakes_first():
    clock = VirtualClock()
    woken = []

    async def sleeper(priority):
        await clock.sleep_until(1.0, priority)
        woken.append(priority)

    await asyncio.gather(*(sleeper(priority) for priority in (16, 3, 31, 0)))

    assert woken == [0, 3, 16, 31]


async def test_a_step_of_the_wall_clock_leaves_monotonic_time_alone():
    clock = VirtualClock()
    before = clock.utc_ns()
    clock.step_utc(3600)
    assert clock.monotonic() == 0.0
    assert clock.utc_ns() - before == 3600 * 10**9


async def test_a_cancelled_sleeper_does_not_hold_up_the_others():
    clock = VirtualClock()
    cancelled = asyncio.create_task(clock.sleep_until(1.0))
    await asyncio.sleep(0)
    cancelled.cancel()
    await clock.sleep_until(2.0)
    assert clock.monotonic() == 2.0


async def test_the_system_clock_wakes_after_the_deadline_and_in_order_of_deadlines():
    clock = SystemClock()
    woken = []

    async def sleeper(delay):
        deadline = start + delay
        await clock.sleep_until(deadline)
        assert clock.monotonic() >= deadline
        woken.append(delay)

    start = clock.monotonic()
    await asyncio.gather(sleeper(0.06), sleeper(0.02), sleeper(0.04), sleeper(-1.0))
    clock.close()

    assert woken == [-1.0, 0.02, 0.04, 0.06]


async def test_an_alarm_that_is_set_ahead_still_wakes_nobody_before_the_deadline():
    clock = SystemClock()
    for _ in range(60):  # enough for it to learn how late it is
        deadline = clock.monotonic() + 0.005
        await clock.sleep_until(deadline)
        assert clock.monotonic() >= deadline
    clock.close()


async def test_an_earlier_sleeper_rearms_a_timer_that_was_set_for_a_later_one():
    clock = SystemClock()
    late = asyncio.create_task(clock.sleep_until(clock.monotonic() + 30.0))
    await asyncio.sleep(0)
    async with asyncio.timeout(20):
        await clock.sleep_until(clock.monotonic() + 0.01)
    late.cancel()
    clock.close()
