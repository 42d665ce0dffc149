"""What a subscription publishes in one message."""

from typing import Any

from asyncua.server.internal_subscription import InternalSubscription


class Subscription(InternalSubscription):  # type: ignore[misc]  # asyncua is untyped here
    """asyncua: all notifications in one message, whatever MaxNotificationsPerPublish says (OPC 10000-4, 5.13.2)."""

    most_notifications = 0  # in one message, 0: any number
    _triggered_datachanges: dict[int, list[Any]]

    async def publish_results(self, requestdata: Any = None) -> bool:
        """Publish, and at once what did not fit into the message; False when nothing was published."""
        published = more = bool(await super().publish_results(requestdata))
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
