"""Sessions: how many, how they are recognised, and what each service may do for whom."""

import math
import os
from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_session import InternalSession, SessionState

from softplc.publishers.opcua.hardened.outstanding import Partings, leave
from softplc.publishers.opcua.hardened.places import has_room
from softplc.publishers.opcua.hardened.reading import check_read, results_of
from softplc.publishers.opcua.hardened.view import Browser

_ANONYMOUS = User(UserRole.Anonymous)


class Session(InternalSession):  # type: ignore[misc]  # asyncua is untyped here
    """One client's session.

    asyncua: its authentication token is a counter, so that anyone takes over anyone's session; every session may
    delete, change, acknowledge and take over every other session's subscriptions; requests of any size are served;
    a write goes straight to the node; Republish of what is not there answers Good with an empty message, and
    node-opcua clients then ask again for ever; a history that nobody keeps is Good and empty.
    """

    def __init__(self, server: Any, name: Any, user: Any) -> None:
        super().__init__(server, server.aspace, server.subscription_service, name, user=user, external=False)
        self.external = True
        self.address = str(name[0])
        self.auth_token = ua.NodeId(os.urandom(32), 0, ua.NodeIdType.ByteString)
        self._browser = Browser(server.aspace, server.reference_types, server.limits)
        self.channel: tuple[Any, ...] | None = None  # who it belongs to: what Secured.identity says
        self.partings = Partings()
        self.processor: Any = None  # the connection that the session is on; None when that was lost
        server.register_external_session(self)

    async def create_session(self, params: Any, sockname: Any = None) -> Any:
        """CreateSession; a requested timeout that is no number is taken as the shortest."""
        if not math.isfinite(params.RequestedSessionTimeout):
            params.RequestedSessionTimeout = 0.0
        return await super().create_session(params, sockname=sockname)

    def activate_session(self, params: Any, peer_certificate: Any) -> Any:
        """ActivateSession; log-ins of named users are told, refused ones too; without one there must be room."""
        before: Any = self.user
        state: Any = self.state
        try:
            result = super().activate_session(params, peer_certificate)
        except ServiceError:
            self.iserver.access.refused(self.address)
            raise
        if self.user.name is None and self.iserver.is_crowded_for(self):
            self._undo_activation(before, state)
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        if self.user.name != before.name and self.user.name is not None:
            self.iserver.access.logged_in(self.user.name, self.address)
        return result

    def _undo_activation(self, user: Any, state: Any) -> None:
        if state is SessionState.Created:
            InternalSession._current_connections -= 1  # asyncua counts the whole process's, up to a thousand
        self.user, self.state = user, state

    async def close_session(self, delete_subs: bool = True) -> None:
        """CloseSession; subscriptions outlive it only where a user can prove that they are his."""
        processor = self.processor
        await super().close_session(delete_subs or self.user.name is None)
        leave(self, processor)

    async def read(self, params: Any) -> list[Any]:
        """Read; UserAccessLevel is the session's own."""
        check_read(params)
        self.iserver.limits.check_operations(params.NodesToRead)
        return results_of(params, self.iserver.attribute_service.read(params), self._may_write)

    async def write(self, params: Any) -> list[Any]:
        """Write: never to a node, always through the rules of `access`."""
        self.iserver.limits.check_operations(params.NodesToWrite)
        return [ua.StatusCode(self._write(item)) for item in params.NodesToWrite]

    async def browse(self, params: Any) -> list[Any]:
        """Browse within the limits of one request."""
        self.iserver.limits.check_operations(params.NodesToBrowse)
        return self._browser.browse(params.NodesToBrowse, params.RequestedMaxReferencesPerNode)

    async def browse_next(self, parameters: Any) -> list[Any]:
        """BrowseNext of the session's own continuation points."""
        self.iserver.limits.check_operations(parameters.ContinuationPoints)
        return self._browser.browse_next(parameters.ContinuationPoints, release=parameters.ReleaseContinuationPoints)

    async def translate_browsepaths_to_nodeids(self, params: Any) -> list[Any]:
        """TranslateBrowsePathsToNodeIds within the limits of one request; an empty path matches nothing."""
        self.iserver.limits.check_operations(params)
        if any(not path.RelativePath.Elements for path in params):
            raise ServiceError(ua.StatusCodes.BadNothingToDo)
        return list(await super().translate_browsepaths_to_nodeids(params))

    async def call(self, params: Any) -> list[Any]:
        """Call: there are no methods."""
        self.iserver.limits.check_operations(params)
        return [ua.CallMethodResult(ua.StatusCode(ua.StatusCodes.BadNotImplemented)) for _ in params]

    async def history_read(self, params: Any) -> list[Any]:
        """HistoryRead: there is no history."""
        self.iserver.limits.check_operations(params.NodesToRead)
        status = ua.StatusCode(ua.StatusCodes.BadHistoryOperationUnsupported)
        return [ua.HistoryReadResult(status) for _ in params.NodesToRead]

    async def create_subscription(self, params: Any, callback: Any, request_callback: Any = None) -> Any:
        """CreateSubscription up to the limit of one session."""
        limits = self.iserver.limits
        if len(self.own()) >= limits.subscriptions_per_session or not self._has_room(subscriptions=1):
            raise ServiceError(ua.StatusCodes.BadTooManySubscriptions)
        result = await super().create_subscription(params, callback, request_callback)
        sub = self.subscription_service.subscriptions[result.SubscriptionId]
        sub.address, sub.user_name = self.address, self.user.name
        return result

    def modify_subscription(self, params: Any) -> Any:
        """ModifySubscription of the session's own."""
        self._check_own(params.SubscriptionId)
        return super().modify_subscription(params)

    async def delete_subscriptions(self, ids: Sequence[int]) -> list[Any]:
        """DeleteSubscriptions of the session's own; others do not exist."""
        ids = ids or ()
        results = iter(await super().delete_subscriptions(own := [number for number in ids if number in self.own()]))
        unknown = ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)
        return [next(results) if number in own else unknown for number in ids]

    async def set_publishing_mode(self, params: Any) -> list[Any]:
        """SetPublishingMode of the session's own; others do not exist."""
        self.iserver.limits.check_operations(params.SubscriptionIds)
        own = self.own()
        params.SubscriptionIds = [number if number in own else 0 for number in params.SubscriptionIds]
        return list(await super().set_publishing_mode(params))

    async def transfer_subscriptions(self, params: Any, callback: Any) -> list[Any]:
        """TransferSubscriptions to the same user's new session; who did not log in cannot prove who he is.

        OPC 10000-4, 5.13.7: without log-in and encryption the answer shall be BadUserAccessDenied.
        """
        self.iserver.limits.check_operations(params.SubscriptionIds)
        service = self.subscription_service
        return [await service.transfer(self, number, callback) for number in params.SubscriptionIds]

    async def create_monitored_items(self, params: Any) -> list[Any]:
        """CreateMonitoredItems on the session's own subscription, up to the limit of one session."""
        self.iserver.limits.check_operations(params.ItemsToCreate)
        self._check_own(params.SubscriptionId)
        held = sum(len(sub.monitored_item_srv) for sub in self.own().values())
        wanted = len(params.ItemsToCreate)
        if held + wanted > self.iserver.limits.items_per_session or not self._has_room(items=wanted):
            raise ServiceError(ua.StatusCodes.BadTooManyMonitoredItems)
        return list(await super().create_monitored_items(params))

    async def modify_monitored_items(self, params: Any) -> list[Any]:
        """ModifyMonitoredItems on the session's own subscription."""
        self._check_own(params.SubscriptionId)
        self.iserver.limits.check_operations(params.ItemsToModify)
        return list(await super().modify_monitored_items(params))

    async def set_monitoring_mode(self, params: Any) -> list[Any]:
        """SetMonitoringMode on the session's own subscription."""
        self._check_own(params.SubscriptionId)
        self.iserver.limits.check_operations(params.MonitoredItemIds)
        return list(await super().set_monitoring_mode(params))

    async def delete_monitored_items(self, params: Any) -> list[Any]:
        """DeleteMonitoredItems on the session's own subscription."""
        self._check_own(params.SubscriptionId)
        self.iserver.limits.check_operations(params.MonitoredItemIds)
        return list(await super().delete_monitored_items(params))

    def republish(self, params: Any) -> Any:
        """Republish a message that is kept. Raises ServiceError when there is none."""
        self._check_own(params.SubscriptionId)
        return self.subscription_service.republish(params)

    def publish(self, acks: Any = None) -> tuple[int, list[Any]]:
        """Publish: acknowledges messages of the session's own subscriptions; their number limits the queue."""
        own = self.own()
        if not own and not self.partings:
            raise ServiceError(ua.StatusCodes.BadNoSubscription)
        results = []
        for ack in acks or ():
            sub = own.get(ack.SubscriptionId)
            results.append(ua.StatusCode(_acknowledge(sub, ack.SequenceNumber)))
        return len(own), results

    def own(self) -> dict[int, Any]:
        """The session's subscriptions."""
        subscriptions = self.subscription_service.subscriptions
        return {number: sub for number, sub in subscriptions.items() if sub.session_id == self.session_id}

    def _check_own(self, subscription_id: int) -> None:
        if subscription_id not in self.own():
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)

    def _has_room(self, *, subscriptions: int = 0, items: int = 0) -> bool:
        everybodys = self.subscription_service.subscriptions.values()
        return has_room(everybodys, self, subscriptions, items, self.iserver.limits)

    def _may_write(self, node_id: Any) -> bool:
        return bool(self.iserver.access.may_write(self.user, node_id))

    def _write(self, item: Any) -> int:
        node = self.aspace.get(item.NodeId)
        if node is None:
            return int(ua.StatusCodes.BadNodeIdUnknown)
        if item.AttributeId not in node.attributes:
            return int(ua.StatusCodes.BadAttributeIdInvalid)
        return int(self.iserver.access.write(self.user, item))


def _acknowledge(sub: Any, sequence_number: int) -> int:
    if sub is None:
        return int(ua.StatusCodes.BadSubscriptionIdInvalid)
    known = sub._not_acknowledged_results.pop(sequence_number, None)
    return int(ua.StatusCodes.Good if known else ua.StatusCodes.BadSequenceNumberUnknown)
