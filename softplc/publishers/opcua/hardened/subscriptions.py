"""Subscriptions: how often they publish, how long they live, and whose they are."""

from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.subscription_service import SubscriptionService

from softplc.publishers.opcua.hardened.outstanding import part
from softplc.publishers.opcua.hardened.publishing import revise_interval


class Subscriptions(SubscriptionService):  # type: ignore[misc]  # asyncua is untyped here
    """asyncua: a publishing interval of NaN never publishes and one of 0 publishes every change on its own; the
    lifetime may be shorter than the keep-alive; ModifySubscription is Good and changes nothing; Republish of what is
    not there is answered Good and empty.
    """

    async def create_subscription(
        self, params: Any, callback: Any, session_id: Any, request_callback: Any = None
    ) -> Any:
        """CreateSubscription with a sane interval and lifetime, and softplc's monitored items."""
        self._revise(params)
        result = await super().create_subscription(params, callback, session_id, request_callback)
        sub = self.subscriptions[result.SubscriptionId]
        sub.most_notifications = params.MaxNotificationsPerPublish
        sub.monitored_item_srv = self.iserver.monitored_items(sub)
        sub.when_expired = self._tell_expired
        return result

    def modify_subscription(self, params: Any) -> Any:
        """ModifySubscription (OPC 10000-4, 5.14.3), with the same limits; Priority counts for nothing."""
        sub = self.subscriptions.get(params.SubscriptionId)
        if sub is None:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)
        self._revise(params)
        told = sub.data
        told.RevisedLifetimeCount = self._clamp_lifetime_count(params.RequestedLifetimeCount)
        told.RevisedMaxKeepAliveCount = self._clamp_keep_alive_count(params.RequestedMaxKeepAliveCount)
        sub.most_notifications = params.MaxNotificationsPerPublish
        sub.publish_every(params.RequestedPublishingInterval)
        sub.prove_alive()
        return ua.ModifySubscriptionResult(
            told.RevisedPublishingInterval, told.RevisedLifetimeCount, told.RevisedMaxKeepAliveCount
        )

    def _revise(self, params: Any) -> None:
        params.RequestedPublishingInterval = revise_interval(params.RequestedPublishingInterval, self.iserver.limits)
        keep_alive = self._clamp_keep_alive_count(params.RequestedMaxKeepAliveCount)
        params.RequestedLifetimeCount = max(params.RequestedLifetimeCount, 3 * keep_alive)

    async def transfer(self, session: Any, number: int, callback: Any) -> Any:
        """Make a subscription this session's, if it is the same user's; `callback` sends its notifications."""
        limits, sub = self.iserver.limits, self.subscriptions.get(number)
        if sub is None:
            return ua.TransferResult(ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid))
        if sub.session_id == session.session_id:
            return ua.TransferResult(ua.StatusCode(ua.StatusCodes.BadNothingToDo))
        if session.user.name is None or sub.user_name != session.user.name:
            return ua.TransferResult(ua.StatusCode(ua.StatusCodes.BadUserAccessDenied))
        held = session.own().values()
        items = sum(len(own.monitored_item_srv) for own in held) + len(sub.monitored_item_srv)
        if len(held) >= limits.subscriptions_per_session or items > limits.items_per_session:
            return ua.TransferResult(ua.StatusCode(ua.StatusCodes.BadTooManySubscriptions))
        before = self._session_of(sub)
        sub.session_id, sub.address = session.session_id, session.address
        sub.pub_result_callback, sub.pub_request_callback = callback, session.processor.get_publish_request
        sub.prove_alive()
        if before is not None:
            await part(before, sub, ua.StatusCodes.GoodSubscriptionTransferred)
        return ua.TransferResult(ua.StatusCode(), sorted(sub._not_acknowledged_results))

    async def _tell_expired(self, sub: Any) -> None:
        session = self._session_of(sub)
        if session is not None:
            await part(session, sub, ua.StatusCodes.BadTimeout)

    def _session_of(self, sub: Any) -> Any:
        """The session whose subscription this is; None when that is closed."""
        sessions = self.iserver._external_sessions.values()
        return next((session for session in sessions if session.session_id == sub.session_id), None)

    def republish(self, params: Any) -> Any:
        """The message with this sequence number, kept until it is acknowledged. Raises ServiceError."""
        sub = self.subscriptions.get(params.SubscriptionId)
        if sub is None:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)
        kept = sub._not_acknowledged_results.get(params.RetransmitSequenceNumber)
        if kept is None:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        return kept.NotificationMessage
