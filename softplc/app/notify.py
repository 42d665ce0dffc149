"""Messages to systemd: READY, STATUS, and the watchdog that the scan loop feeds (sd_notify protocol)."""

import contextlib
import os
import socket


def notify(message: str) -> bool:
    """Send one state to the service manager; False when there is none that listens."""
    path = os.environ.get("NOTIFY_SOCKET")
    if not path:
        return False
    address = "\0" + path[1:] if path.startswith("@") else path
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel, contextlib.suppress(OSError):
        channel.setblocking(False)  # a service manager that does not read must not stop the scan
        channel.sendto(message.encode(), address)
        return True
    return False


def watchdog_interval() -> float | None:
    """Seconds within which the service manager wants a sign of life; None when it does not."""
    microseconds = os.environ.get("WATCHDOG_USEC", "")
    return int(microseconds) / 1e6 if microseconds.isdigit() and int(microseconds) > 0 else None


class Watchdog:
    """Feeds the service manager's watchdog while every task of the scan process scans.

    `beat` is called in every scan with the task's number; the watchdog is fed when each task scanned since it was
    fed last, at most four times per interval. A stuck task starves it.
    """

    def __init__(self, tasks: int, interval: float | None) -> None:
        self._missing = set(range(tasks))
        self._tasks = tasks
        self._interval = interval
        self._next = float("-inf")

    def beat(self, task: int, now: float) -> None:
        """One scan of this task is complete at `now` on the monotonic clock."""
        if self._interval is None:
            return
        self._missing.discard(task)
        if not self._missing and now >= self._next:
            self._next = now + self._interval / 4
            self._missing = set(range(self._tasks))
            notify("WATCHDOG=1")
