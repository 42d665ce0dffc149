"""Publish requests that wait, and what they are answered when a subscription or their session is gone.

asyncua: a subscription that expired or was transferred says nothing to the session that had it; requests of a session
that was closed wait on, and get what its subscriptions have to say to the next session.
"""

from collections import deque
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.uaprocessor import PublishRequestData

_MOST: Final = 100  # of what a session was not told yet


class Partings(deque[Any]):
    """Messages of subscriptions that left a session, until Publish requests come for them; the newest hundred."""

    def __init__(self) -> None:
        super().__init__(maxlen=_MOST)


async def publish(processor: Any, header: Any, sequence: Any, params: Any) -> bool:
    """Publish (OPC 10000-4, 5.14.5): answered at once where something waits for it. Raises ServiceError."""
    session = processor.session
    if not session.is_activated():
        raise ServiceError(ua.StatusCodes.BadSessionNotActivated)
    session.touch()
    processor.session_last_activity = session._last_activity
    count, results = session.publish(params.SubscriptionAcknowledgements)
    request = PublishRequestData(header, sequence, results)
    if session.partings:
        await processor.forward_publish_response(session.partings.popleft(), request)
        return True
    late = processor._publish_results_subs
    while late:
        number = next(iter(late))
        del late[number]
        sub = session.subscription_service.subscriptions.get(number)
        if sub is not None and sub.session_id == session.session_id and await sub.publish_results(request):
            return True
    if len(processor._publish_requests) >= processor.publish_request_limit(count):
        processor._evict_publish_request()
    processor._publish_requests.append(request)
    return True


async def part(session: Any, sub: Any, status: int) -> None:
    """The subscription left this session, and this is why (OPC 10000-4, 5.14.1.3, StatusChangeNotification)."""
    message = ua.NotificationMessage(sub._notification_seq)
    message.NotificationData = [ua.StatusChangeNotification(ua.StatusCode(status))]
    session.partings.append(ua.PublishResult(sub.data.SubscriptionId, [], False, message))
    processor = session.processor
    if processor is None:
        return
    while session.partings and processor._publish_requests:
        request = processor.get_publish_request(sub.data.SubscriptionId)
        if request is not None:
            await processor.forward_publish_response(session.partings.popleft(), request)
    if not session.own():
        refuse(processor, ua.StatusCodes.BadNoSubscription)


def leave(session: Any, processor: Any) -> None:
    """The session is closed, and its connection is told; subscriptions that it leaves wait for another session."""
    for sub in session.own().values():
        sub.pub_request_callback = _nobody
    if processor is not None:
        refuse(processor, ua.StatusCodes.BadSessionClosed)


def refuse(processor: Any, status: int) -> None:
    """All Publish requests that wait get this status."""
    processor._publish_results_subs.clear()
    while processor._publish_requests:
        request = processor._publish_requests.popleft()
        if not processor._transport.is_closing():
            fault = ua.ServiceFault()
            fault.ResponseHeader.ServiceResult = ua.StatusCode(status)
            processor.send_response(request.requesthdr.RequestHandle, request.seqhdr, fault)


def _nobody(_: int) -> None:
    """No Publish request, for there is no session."""
