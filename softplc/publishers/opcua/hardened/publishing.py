"""When a subscription publishes, and what in one message."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from asyncua.server.internal_subscription import InternalSubscription

from softplc.publishers.opcua.hardened.limits import Limits


def revise_interval(requested: float, limits: Limits) -> float:
    """The publishing interval, ms, that is nearest to what was requested; NaN is as often as possible."""
    if not requested > limits.min_publishing_ms:
        return limits.min_publishing_ms
    return min(requested, limits.max_publishing_ms)


class Subscription(InternalSubscription):  # type: ignore[misc]  # asyncua is untyped here
    """asyncua: all notifications in one message, whatever MaxNotificationsPerPublish says (OPC 10000-4, 5.14.2); a
    subscription stays as it was created; one that expires tells nobody.
    """

    most_notifications = 0  # in one message, 0: any number
    when_expired: Callable[[Any], Awaitable[None]]
    _triggered_datachanges: dict[int, list[Any]]
    _task: asyncio.Task[None] | None

    def publish_every(self, interval: float) -> None:
        """Publish every so many ms from now on, first when the shorter of this and the interval before has passed."""
        before, self.data.RevisedPublishingInterval = self.data.RevisedPublishingInterval, interval
        if self._task is not None and interval != before:
            self._task.cancel()
            self._task = asyncio.create_task(self._after(min(before, interval) / 1000.0))

    def prove_alive(self) -> None:
        """Somebody uses it: its lifetime begins anew (OPC 10000-4, 5.14.1.2, ResetLifetimeCounter)."""
        self._publish_cycles_count = 0

    async def _after(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        await self._subscription_loop()

    async def publish_results(self, requestdata: Any = None) -> bool:
        """Publish, and at once what did not fit into the message; False when nothing was published."""
        if requestdata is not None:
            self.prove_alive()
        expires = self._publish_cycles_count > self.data.RevisedLifetimeCount
        published = more = bool(await super().publish_results(requestdata))
        if expires:
            await self.when_expired(self)
        while more and self._is_waiting():
            more = bool(await super().publish_results())
        return published

    def _is_waiting(self) -> bool:
        """Data changes wait that may be published."""
        return bool(self._publishing_enabled and self._triggered_datachanges)

    def _pop_publish_result(self) -> Any:
        result = super()._pop_publish_result()
        result.MoreNotifications = self._is_waiting()
        return result

    def _pop_triggered_datachanges(self, result: Any) -> None:
        self._triggered_datachanges, rest = split(self._triggered_datachanges, self.most_notifications)
        super()._pop_triggered_datachanges(result)
        self._triggered_datachanges = rest


def split(queues: dict[int, list[Any]], most: int) -> tuple[dict[int, list[Any]], dict[int, list[Any]]]:
    """The first so many notifications of these items, all for 0, and the others."""
    if not most:
        return queues, {}
    first: dict[int, list[Any]] = {}
    rest: dict[int, list[Any]] = {}
    for item, queue in queues.items():
        if most:
            first[item] = queue[:most]
        if len(queue) > most:
            rest[item] = queue[most:]
        most = max(most - len(queue), 0)
    return first, rest
