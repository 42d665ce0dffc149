"""The only module that asks what time it is: SystemClock for a plant, VirtualClock for tests and replay.

SystemClock wakes by timerfd in the event loop. `asyncio.sleep` rounds up to epoll's milliseconds and is late
by 0.7 to 1.4 ms in the median; a timerfd with an absolute deadline is late by 0.1 to 0.2 ms on stock Linux, most of
which is always the same and can be set the alarm ahead by (bench/wakeup.py measures it here). Where there is no
timerfd, `loop.call_at` serves.
"""

import asyncio
import ctypes
import heapq
import os
import sys
import time
from collections.abc import Callable
from itertools import count
from typing import Protocol

_LEAD_MOST = 200e-6  # seconds that the alarm is set ahead at most …
_LEAD_SHARE = 0.01  # … and as a part of the time to sleep: what is too early is waited for in a busy loop
_LEAD_STEP = 10e-6
_SETTLE_TURNS = 20  # turns of the loop that everyone gets before virtual time moves on


class Clock(Protocol):
    """Time as the engine sees it. Seconds are floats on the monotonic clock; `utc_ns` is wall time."""

    def monotonic(self) -> float:
        """Seconds since an arbitrary start; never steps, never goes back."""
        ...

    def utc_ns(self) -> int:
        """Nanoseconds since 1970-01-01 UTC; steps when the wall clock is set."""
        ...

    async def sleep_until(self, deadline: float, priority: int = 0) -> None:
        """Return at `deadline` on the monotonic clock; of those due together the lowest priority number is first."""
        ...

    def close(self) -> None:
        """Release what the clock holds of the system."""
        ...


class _Sleepers:
    """Those who wait, ordered by deadline; those due together are woken in order of priority."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, int, asyncio.Future[None]]] = []
        self._order = count()

    def add(self, deadline: float, priority: int) -> asyncio.Future[None]:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._heap, (deadline, priority, next(self._order), future))
        return future

    def next_deadline(self) -> float | None:
        while self._heap and self._heap[0][3].done():
            heapq.heappop(self._heap)
        return self._heap[0][0] if self._heap else None

    def wake(self, now: float) -> None:
        due: list[tuple[int, int, asyncio.Future[None]]] = []
        while self._heap and self._heap[0][0] <= now:
            _, priority, order, future = heapq.heappop(self._heap)
            due.append((priority, order, future))
        for _, _, future in sorted(due, key=lambda entry: entry[:2]):
            if not future.done():
                future.set_result(None)


class SystemClock:
    """The machine's clocks, and wake-ups by timerfd where the system has it.

    The alarm is set ahead by the median of how late it was so far; nobody is woken before his deadline.
    """

    def __init__(self) -> None:
        self._sleepers = _Sleepers()
        self._armed: float | None = None
        self._late = 0.0  # median, seconds
        self._lead = 0.0
        self._alarm: _TimerFd | _LoopTimer | None = None

    def monotonic(self) -> float:
        """Seconds of CLOCK_MONOTONIC."""
        return time.monotonic()

    def utc_ns(self) -> int:
        """Nanoseconds of CLOCK_REALTIME."""
        return time.time_ns()

    async def sleep_until(self, deadline: float, priority: int = 0) -> None:
        """Wake at the absolute deadline; a deadline in the past still yields once to the loop."""
        future = self._sleepers.add(deadline, priority)
        self._arm()
        await future

    def close(self) -> None:
        """Close the timer; sleepers are woken by nobody any more."""
        if self._alarm is not None:
            self._alarm.close()
            self._alarm = None

    def _arm(self) -> None:
        deadline = self._sleepers.next_deadline()
        if deadline is None or deadline == self._armed:
            return
        if self._alarm is None:
            self._alarm = _open_alarm(self._on_alarm)
        self._armed = deadline
        self._lead = max(min(self._late, _LEAD_MOST, _LEAD_SHARE * (deadline - time.monotonic())), 0.0)
        self._alarm.arm(deadline - self._lead)

    def _on_alarm(self) -> None:
        now, deadline, self._armed = time.monotonic(), self._armed, None
        if deadline is not None:
            self._late += _LEAD_STEP if now > deadline - self._lead + self._late else -_LEAD_STEP
            while now < deadline:
                now = time.monotonic()
        self._sleepers.wake(now)
        self._arm()


class _TimerFd:
    """A Linux timerfd on CLOCK_MONOTONIC with absolute deadlines, read by the event loop."""

    def __init__(self, fd: int, settime: Callable[[int, float], None], callback: Callable[[], None]) -> None:
        self._fd, self._settime, self._callback = fd, settime, callback
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(fd, self._expired)

    def arm(self, deadline: float) -> None:
        self._settime(self._fd, max(deadline, 1e-9))  # zero would disarm it

    def close(self) -> None:
        if not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
        os.close(self._fd)

    def _expired(self) -> None:
        try:
            os.read(self._fd, 8)
        except BlockingIOError:
            return
        self._callback()


class _LoopTimer:
    """The event loop's own timer, where there is no timerfd."""

    def __init__(self, callback: Callable[[], None]) -> None:
        self._callback = callback
        self._loop = asyncio.get_running_loop()
        self._handle: asyncio.TimerHandle | None = None

    def arm(self, deadline: float) -> None:
        self.close()
        delay = max(deadline - time.monotonic(), 0.0)
        self._handle = self._loop.call_later(delay, self._callback)

    def close(self) -> None:
        if self._handle is not None:
            self._handle.cancel()


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("it_interval", _Timespec), ("it_value", _Timespec))


def _open_alarm(callback: Callable[[], None]) -> "_TimerFd | _LoopTimer":
    if sys.platform != "linux":
        return _LoopTimer(callback)
    if sys.version_info >= (3, 13):
        flags = os.TFD_NONBLOCK | os.TFD_CLOEXEC
        fd = os.timerfd_create(time.CLOCK_MONOTONIC, flags=flags)
        return _TimerFd(fd, _settime_os, callback)
    libc = ctypes.CDLL(None, use_errno=True)
    fd = libc.timerfd_create(time.CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
    if fd < 0:
        return _LoopTimer(callback)

    def settime(fd: int, deadline: float) -> None:
        seconds = int(deadline)
        spec = _Itimerspec(_Timespec(0, 0), _Timespec(seconds, int((deadline - seconds) * 1e9)))
        libc.timerfd_settime(fd, _TFD_TIMER_ABSTIME, ctypes.byref(spec), None)

    return _TimerFd(fd, settime, callback)


_TFD_TIMER_ABSTIME = 1


def _settime_os(fd: int, deadline: float) -> None:
    if sys.version_info >= (3, 13):
        os.timerfd_settime(fd, flags=os.TFD_TIMER_ABSTIME, initial=deadline, interval=0.0)


class VirtualClock:
    """Time that moves only when everyone sleeps, or when `advance` is called: exact, repeatable, at once.

    A sleeper's wake-up moves time to its deadline after every other coroutine had its turns; nothing that
    does real I/O belongs under this clock.
    """

    def __init__(self, start: float = 0.0, utc_ns: int = 1_700_000_000_000_000_000) -> None:
        self._now = start
        self._utc_offset_ns = utc_ns - round(start * 1e9)
        self._sleepers = _Sleepers()
        self._scheduled = False

    def monotonic(self) -> float:
        """Virtual seconds."""
        return self._now

    def utc_ns(self) -> int:
        """Virtual wall time."""
        return self._utc_offset_ns + round(self._now * 1e9)

    def advance(self, seconds: float) -> None:
        """Let time pass, as work does that takes this long."""
        self._now += seconds

    def step_utc(self, seconds: float) -> None:
        """Set the wall clock forward or back, as an NTP step does; monotonic time does not move."""
        self._utc_offset_ns += round(seconds * 1e9)

    async def sleep_until(self, deadline: float, priority: int = 0) -> None:
        """Wake when virtual time reaches the deadline."""
        future = self._sleepers.add(deadline, priority)
        self._schedule(_SETTLE_TURNS)
        await future

    def close(self) -> None:
        """Nothing to release."""

    def _schedule(self, turns: int) -> None:
        if not self._scheduled:
            self._scheduled = True
            asyncio.get_running_loop().call_soon(self._turn, turns)

    def _turn(self, turns: int) -> None:
        self._scheduled = False
        if turns > 0:
            self._schedule(turns - 1)
            return
        deadline = self._sleepers.next_deadline()
        if deadline is not None:
            self._now = max(self._now, deadline)
            self._sleepers.wake(self._now)
            if self._sleepers.next_deadline() is not None:
                self._schedule(_SETTLE_TURNS)
