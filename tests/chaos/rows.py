"""The rows of the chaos suite: a fault, what is expected, and what was seen.

A row raises AssertionError when the expectation does not hold, and returns the figures that it measured. In the
short form it asserts states and orders of events, which a machine that is not overloaded keeps; the long form also
holds the times against their limits.
"""

import asyncio
import gc
import random
import signal
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import numpy as np

from softplc.clock import monotonic
from softplc.sample import StatusCode
from tests.chaos import spoils
from tests.chaos.claims import BACK, LATE, UNREPORTED, Size, descriptors, milliseconds, never_old, noticed
from tests.chaos.neighbours import neighbours
from tests.chaos.rig import KINDS, PERIOD, RATE, Rig
from tests.support.proxy import Mode


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    fault: str
    expectation: str
    run: Callable[[Rig, Size], Awaitable[str]]


async def reset(rig: Rig, size: Size) -> str:
    gc.collect()
    tasks, fds = len(asyncio.all_tasks()), descriptors()
    times: dict[str, list[float]] = {kind: [] for kind in KINDS}

    async def one(kind: str) -> None:
        for _ in range(size.resets):
            begun = monotonic()
            rig.proxies[kind].reset()
            times[kind].append(await rig.good(kind, begun, 2) - begun)

    begun = monotonic()
    await asyncio.gather(*(one(kind) for kind in KINDS))
    never_old(rig, begun, size.detected)
    await rig.all_good()
    await rig.rest(1.2)  # a farewell takes up to a second
    gc.collect()
    await rig.until(lambda: len(asyncio.all_tasks()) <= tasks + 2, "the tasks are as many as before")
    await rig.until(lambda: descriptors() <= fds, "the descriptors are as many as before")
    return f"{size.resets} each, Good again: " + "; ".join(f"{k} {milliseconds(v)}" for k, v in times.items())


async def blackhole(rig: Rig, size: Size) -> str:
    start = await rig.switch(Mode.BLACKHOLE)
    await rig.rest(LATE + 0.3)
    end = await rig.switch(Mode.PASS)
    told = noticed(rig, start, end, size)
    never_old(rig, start, size.detected)
    for kind in ("poll", "modbus"):
        assert not [seen for seen in rig.since(start, kind) if seen.good and seen.start < end]
    await rig.all_good()
    return told


def outages(mode: Mode) -> Callable[[Rig, Size], Awaitable[str]]:
    async def run(rig: Rig, size: Size) -> str:
        figures = []
        for seconds in size.outages:
            times: dict[str, list[float]] = {kind: [] for kind in KINDS}
            for _ in range(max(1, round(size.repeats / seconds))):
                start = await rig.switch(mode)
                await rig.rest(seconds + random.uniform(0.0, 0.8))  # the attempts' phase must not be always the same
                back = await rig.switch(Mode.PASS)
                for kind, first in zip(KINDS, await asyncio.gather(*(rig.good(k, back) for k in KINDS)), strict=True):
                    times[kind].append(first - back)
                await rig.all_good()
                never_old(rig, start, size.detected)
                rig.forget()
            everyone = [time for kind in KINDS for time in times[kind]]
            figures.append(f"after {seconds:g} s: {milliseconds(everyone)} ({len(everyone)} ×)")
            assert not size.strict or np.percentile(everyone, 99) <= BACK, figures[-1]
        return "first Good " + "; ".join(figures)

    return run


async def stopped(rig: Rig, size: Size) -> str:
    start = monotonic()
    rig.signal(signal.SIGSTOP)
    try:
        await rig.rest(2.0)
    finally:
        end = monotonic()
        rig.signal(signal.SIGCONT)
    back = await asyncio.gather(*(rig.good(kind, end) for kind in KINDS))
    await rig.all_good()
    told = noticed(rig, start, end, size)
    never_old(rig, start, size.detected)
    good = {
        kind: [seen.velocity for seen in rig.since(end, kind) if seen.velocity_status == StatusCode.GOOD]
        for kind in KINDS
    }
    for kind, velocities in good.items():
        # reports that come in bunches on a slow machine make the velocity of a subscription ripple
        most = 2.0 if size.strict or kind != "subscribe" else 8.0
        assert all(abs(velocity) <= most * RATE for velocity in velocities), f"{kind}: {velocities} at {RATE:g} u/s"
    low, high = min(min(each) for each in good.values()), max(max(each) for each in good.values())
    return f"{told}; first Good {milliseconds([t - end for t in back])} after; velocity {low:.1f} … {high:.1f} u/s"


async def bad_replies(rig: Rig, size: Size) -> str:
    count = 0
    for spoil in (*spoils.ANY.values(), None):
        start = monotonic()
        for kind in KINDS:
            rig.proxies[kind].spoil = spoil
            if spoil is None:
                rig.proxies[kind].truncate()
        await rig.rest(2.0 if size.strict else 0.2)
        for kind in KINDS:
            rig.proxies[kind].spoil = None
            rig.proxies[kind].reset()
        await rig.all_good()
        never_old(rig, start, size.detected)
        count += 1
    return f"{count} kinds of reply, 0 of them Good"


async def wrong_modbus(rig: Rig, size: Size) -> str:
    for name, spoil in spoils.MODBUS.items():
        start = monotonic()
        rig.proxies["modbus"].spoil = spoil
        await rig.rest(1.0 if size.strict else 0.1)
        end = monotonic()
        rig.proxies["modbus"].spoil = None
        await rig.good("modbus", end, 2)
        good = [seen for seen in rig.since(start, "modbus") if seen.good and seen.start < end]
        assert not good, f"{name}: Good with {good[0]}"
        never_old(rig, start, size.detected, ("poll", "subscribe"))
    return f"{len(spoils.MODBUS)} kinds of reply, 0 of them Good"


async def other_server(rig: Rig, size: Size) -> str:
    start = monotonic()
    await rig.replace_opcua(shift=True)
    ready = monotonic()
    back = await asyncio.gather(*(rig.good(kind, ready) for kind in ("poll", "subscribe")))
    await rig.all_good()
    never_old(rig, start, size.detected)
    return f"first Good {milliseconds([t - ready for t in back])} after it was ready, with the right value"


async def dead_subscription(rig: Rig, size: Size) -> str:
    rig.proxies["subscribe"].spoil = spoils.WithoutPublishResponses()
    start = monotonic()
    await rig.rest(LATE + 0.8)
    end = monotonic()
    rig.proxies["subscribe"].spoil = None
    rig.proxies["subscribe"].reset()
    await rig.good("subscribe", end, 5)
    ages = [seen.age for seen in rig.since(start, "subscribe") if seen.good]
    never_old(rig, start, UNREPORTED if size.strict else LATE)
    return f"oldest Good value {max(ages) * 1e3:.0f} ms; reads went on"


async def slow(rig: Rig, size: Size) -> str:
    figures = []
    for scans in (0.8, 1.5, 3.0) if size.strict else (0.8, 3.0):
        for kind in ("poll", "modbus"):
            rig.proxies[kind].delay = scans * PERIOD / 2  # there and back
            rig.proxies[kind].most_ahead = 0
        await rig.rest(0.3)
        start = monotonic()
        await rig.rest(3.0 if size.strict else 0.6)
        end = monotonic()
        for kind in ("poll", "modbus"):
            proxy = rig.proxies[kind]
            seen = [each for each in rig.since(start, kind) if each.start < end]
            assert not [each for each in seen if each.good], f"{kind}: Good though the reply takes {scans} scans"
            assert len({each.raw for each in seen}) > 2, f"{kind}: no new values"
            assert proxy.most_ahead <= 2, f"{kind}: {proxy.most_ahead} requests at once"  # one, and a chore
            low, high = min(each.velocity for each in seen), max(each.velocity for each in seen)
            figures.append(f"{kind} {scans:g} scans: {low:.1f} … {high:.1f} u/s")
            proxy.delay = 0.0
        await rig.all_good()
    return "Uncertain throughout; velocity " + ", ".join(figures)


FAULTS = ("stall", "hold", "blackhole", "refuse", "delay", "spoil", "reset", "truncate", "nothing")


async def everything(rig: Rig, size: Size) -> str:
    """Faults drawn by lot, often several at a time, each source by itself; the same ones each time."""
    chance = random.Random(7)
    start = monotonic()
    until = start + (120.0 if size.strict else 3.0)
    counts: dict[str, int] = {}

    async def torment(kind: str) -> None:
        proxy = rig.proxies[kind]
        bad = list(spoils.ANY.values()) + (list(spoils.MODBUS.values()) if kind == "modbus" else [])
        while monotonic() < until:
            fault = chance.choice(
                ("stall", "hold", "blackhole", "refuse", "delay", "spoil", "reset", "truncate", "nothing")
            )
            counts[fault] = counts.get(fault, 0) + 1
            match fault:
                case "stall" | "hold" | "blackhole" | "refuse":
                    await proxy.switch(Mode(fault))
                case "delay":
                    proxy.delay = chance.uniform(0.0, 0.2)
                case "spoil":
                    proxy.spoil = chance.choice(bad)
                case "reset":
                    proxy.reset()
                case "truncate":
                    proxy.truncate()
            await rig.rest(chance.choice((0.02, 0.1, 0.3, 0.7)))
            if fault in ("stall", "hold", "blackhole", "refuse") or chance.random() < 0.5:
                await proxy.switch(Mode.PASS)
                proxy.delay, proxy.spoil = 0.0, None
                await rig.rest(chance.choice((0.02, 0.1, 0.5)))
        await proxy.switch(Mode.PASS)
        proxy.delay, proxy.spoil = 0.0, None

    await asyncio.gather(*(torment(kind) for kind in KINDS))
    for kind in KINDS:
        rig.proxies[kind].reset()
    await rig.all_good()
    never_old(rig, start, UNREPORTED if size.strict else LATE)
    good = [sum(seen.good for seen in rig.since(start, kind)) for kind in KINDS]
    scans = len(rig.since(start, KINDS[0]))
    assert all(good), f"{good} Good"
    return f"{sum(counts.values())} faults in {scans} scans, {sum(good)} values Good and none of them old or wrong"


ROWS: tuple[Row, ...] = (
    Row("reset", "connections reset, again and again", "none stuck; tasks and descriptors as before", reset),
    Row("blackhole", "the cable is pulled (half-open)", "not Good after max(2 scans, 250 ms)", blackhole),
    Row("refused", "nobody listens for a while", "first Good within 1 s (p99)", outages(Mode.REFUSE)),
    Row("cut", "the cable is pulled for a while", "first Good within 1 s (p99)", outages(Mode.BLACKHOLE)),
    Row("stalled", "accepted, nothing forwarded for a while", "first Good within 1 s (p99)", outages(Mode.STALL)),
    Row("stopped", "SIGSTOP of both PLCs for 2 s, ramp of 10 u/s", "never old and Good; sane velocity", stopped),
    Row("bad replies", "garbage, zeros, text, none, doubled, tail, truncated", "nothing of it is Good", bad_replies),
    Row("wrong Modbus", "transaction, length, unit, function, count", "nothing of it is Good", wrong_modbus),
    Row("another server", "SIGKILL, restart with other indices", "found by URI, never a wrong tag", other_server),
    Row("dead subscription", "no more reports while reads work", "never old and Good; rebuilt", dead_subscription),
    Row("slow", "replies after 0.8, 1.5 and 3 scans", "one request at a time, Uncertain, right velocity", slow),
    Row("everything", "all of these by lot, overlapping", "never old or wrong and Good; Good in the end", everything),
    Row("silent neighbour", "one of ten devices falls silent", "the others keep rate and status", neighbours),
)
