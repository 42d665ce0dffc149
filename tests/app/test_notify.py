import socket

import pytest

from softplc.app.notify import Watchdog, notify, watchdog_interval


@pytest.fixture
def service_manager(tmp_path, monkeypatch):
    """A socket that listens where systemd would."""
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(path))
        yield listener


def received(listener: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(listener.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_a_state_reaches_the_service_manager(service_manager):
    assert notify("READY=1")
    assert received(service_manager) == ["READY=1"]


def test_without_a_service_manager_nothing_happens(monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert not notify("READY=1")


def test_the_watchdog_interval_is_the_service_managers(monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "3000000")
    assert watchdog_interval() == 3.0
    monkeypatch.setenv("WATCHDOG_USEC", "")
    assert watchdog_interval() is None


def test_a_scanning_process_feeds_the_watchdog_and_not_in_every_scan(service_manager):
    watchdog = Watchdog(tasks=1, interval=1.0)
    fed = 0
    for k in range(100):
        watchdog.beat(0, k * 0.05)
        fed += len(received(service_manager))
    # 5 s of scans, fed four times per second at the most
    assert 15 <= fed <= 21


def test_a_service_manager_that_does_not_read_does_not_hold_up_the_scan(service_manager):
    watchdog = Watchdog(tasks=1, interval=0.001)
    for k in range(1000):
        watchdog.beat(0, float(k))
    assert received(service_manager)


def test_one_stuck_task_starves_the_watchdog_though_the_other_scans(service_manager):
    watchdog = Watchdog(tasks=2, interval=1.0)
    watchdog.beat(0, 0.0)
    watchdog.beat(1, 0.0)
    assert received(service_manager) == ["WATCHDOG=1"]
    for k in range(1, 200):
        watchdog.beat(0, k * 0.05)
    assert received(service_manager) == []
