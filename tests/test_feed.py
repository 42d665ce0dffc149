import asyncio

from softplc.clock import VirtualClock
from softplc.feed import Feed
from softplc.snapshot import Snapshot
from tests.support.exchange import Exchange, make_exchange


class Recorder:
    """A publisher that keeps what it was given, and when."""

    def __init__(self, exchange: Exchange, fails: int = 0) -> None:
        self._exchange, self._fails = exchange, fails
        self.seen: list[tuple[float, Snapshot]] = []

    async def open(self) -> str:
        return ""

    async def publish(self) -> None:
        self.seen.append((self._exchange.clock.monotonic(), self._exchange.reader.snapshot()))
        if len(self.seen) <= self._fails:
            raise OSError("no")

    async def close(self) -> None:
        pass


async def run(feeds: list[Feed], clock: VirtualClock, seconds: float) -> None:
    tasks = [asyncio.create_task(feed.run()) for feed in feeds]
    await clock.sleep_until(clock.monotonic() + seconds)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_publishers_with_one_interval_say_at_the_same_time_that_a_task_died():
    exchange = make_exchange(clock := VirtualClock())
    exchange.publish()
    publishers = [Recorder(exchange), Recorder(exchange)]
    start = clock.monotonic()

    await run([Feed("a", each, clock, 0.02, start) for each in publishers], clock, 0.5)

    first, second = (publisher.seen for publisher in publishers)
    assert [(at, snapshot.version, snapshot.alive) for at, snapshot in first] == [
        (at, snapshot.version, snapshot.alive) for at, snapshot in second
    ]
    assert [snapshot.alive for _, snapshot in first].count((False,)) >= 10


async def test_a_publisher_that_fails_is_called_again_and_does_not_silence_the_other():
    exchange = make_exchange(clock := VirtualClock())
    failing, other = Recorder(exchange, fails=3), Recorder(exchange)
    feeds = [Feed("failing", failing, clock, 0.02, 0.0), Feed("other", other, clock, 0.02, 0.0)]

    await run(feeds, clock, 0.2)

    assert [feed.errors for feed in feeds] == [3, 0]
    assert len(failing.seen) == len(other.seen) >= 9
