"""One subscription and its publish requests: newest values in, every doubt about it a fault.

A subscription that died looks like one whose values do not change. So each of these is a fault, which the driver
raises as LinkError, and the link starts anew:

- no notification and no keep-alive for longer than `stale_after` (the keep-alive is asked for at a third of it);
- the server says that the subscription's state changed, as when its lifetime ended;
- a gap in the sequence numbers: a change was lost, and the value shown could be old for ever;
- a publish request that fails for any reason.
"""

import asyncio
from collections.abc import Callable, Sequence
from typing import Final

from asyncua import ua

from softplc.clock import Clock
from softplc.drivers.opcua.binding import BATCH, Binding, read_value
from softplc.drivers.opcua.fast.notification import Published, publish, read_published
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.records import OddBodyError
from softplc.drivers.opcua.fast.seam import decode_message
from softplc.drivers.opcua.session import Session, batches, link_errors
from softplc.drivers.opcua.values import overflowed
from softplc.errors import LinkError

OUTSTANDING: Final = 2
"""Publish requests in flight: the server has always one to answer while the other's answer travels."""
MAX_NOTIFICATIONS: Final = 1000
"""In one message; more come in the next, so that decoding does not hold up a scan."""
SLOWEST_KEEP_ALIVE: Final = 10.0
LIFETIME: Final = 30.0
"""Seconds without a publish request after which the server drops the subscription, at least."""

Deliver = Callable[[int, ua.DataValue, float], None]
"""Takes (handle, value, arrival on the monotonic clock)."""
TakeChanges = Callable[[bytes, Published, float], None]
"""Takes all changes of a message at once: (body, where they are, arrival). Raises OddBodyError when it cannot."""


class Subscription:
    """A subscription for monitored values; `deliver` is called for the newest of each item in each notification.

    Times in seconds. `fault` is what is wrong with it, None while all is well; `news` is set by every notification
    and by the fault; `last_sign` is the monotonic time of the last notification or keep-alive; `skipped` counts
    samples that a newer one of the same message superseded, and queues that overflowed at the server, in messages
    that asyncua decoded. With `take_changes` the others are not decoded by asyncua; `slow` counts those that are.
    """

    def __init__(
        self,
        session: Session,
        clock: Clock,
        publishing: float,
        stale_after: float,
        deliver: Deliver,
        slow: SlowState,
        take_changes: TakeChanges | None = None,
    ) -> None:
        self._slow = slow
        self._take_changes = take_changes
        self.fault: LinkError | None = None
        self.news = asyncio.Event()
        self.last_sign = clock.monotonic()
        self.skipped = 0
        self.publishing = publishing
        self.sampling = 0.0
        self._session = session
        self._clock = clock
        self._stale_after = stale_after
        self._deliver = deliver
        self._id = 0
        self._items: dict[int, int] = {}  # the server's number of the item, for each handle
        self._next_number: int | None = None
        self._workers: set[asyncio.Task[None]] = set()

    async def open(self) -> None:
        """Create it and start publishing. Raises LinkError, also when its keep-alive cannot prove life in time."""
        result = await self._create()
        if result.RevisedMaxKeepAliveCount > self._keep_alive_count(self.publishing):
            await self._session.delete_subscription(self._id)  # it publishes more slowly than asked: fewer counts do
            result = await self._create()
        keep_alive = self.publishing * result.RevisedMaxKeepAliveCount
        if keep_alive * 1.5 > self._stale_after:
            raise LinkError(
                f"{self._session.url}: the server sends a keep-alive every {keep_alive * 1000:g} ms; expected "
                f"stale_after_ms of {keep_alive * 2000:g} or more (it is {self._stale_after * 1000:g}), or mode: poll"
            )
        self.last_sign = self._clock.monotonic()
        for number in range(OUTSTANDING):
            worker = asyncio.get_running_loop().create_task(self._publish(), name=f"opcua publish {number}")
            self._workers.add(worker)
            worker.add_done_callback(self._ended)

    async def monitor(
        self,
        bindings: Sequence[Binding],
        stamped: Sequence[bool],
        sampling: float,
        queue: int,
    ) -> None:
        """Report changes of these variables under their handles; a variable that is refused has its problem told.

        Of those that are `stamped` a new source timestamp is a change, too. Raises LinkError when the server does not
        answer.
        """
        await self.forget(bindings)
        pairs = list(zip(bindings, stamped, strict=True))
        for some in batches(pairs, min(BATCH, self._session.limits.monitor)):
            items = [
                ua.MonitoredItemCreateRequest(
                    ItemToMonitor=read_value(binding.node),
                    MonitoringMode=ua.MonitoringMode.Reporting,
                    RequestedParameters=ua.MonitoringParameters(
                        ClientHandle=binding.handle,
                        SamplingInterval=sampling * 1000.0,
                        Filter=_with_timestamp() if by_stamp else None,
                        QueueSize=queue,
                        DiscardOldest=True,
                    ),
                )
                for binding, by_stamp in some
            ]
            results = await self._session.create_monitored_items(
                ua.CreateMonitoredItemsParameters(self._id, ua.TimestampsToReturn.Source, items)
            )
            for (binding, _), result in zip(some, results, strict=True):
                status = int(result.StatusCode.value)
                binding.monitored = result.StatusCode.is_good()
                if binding.monitored:
                    self._items[binding.handle] = int(result.MonitoredItemId)
                    self.sampling = max(self.sampling, result.RevisedSamplingInterval / 1000.0)
                else:
                    binding.lose(status, f"{binding.address}: cannot be monitored: {ua.StatusCode(status).name}")

    async def forget(self, bindings: Sequence[Binding]) -> None:
        """Have these reported no more; one that the server has not any more is none the worse. Raises LinkError."""
        items = [self._items.pop(binding.handle) for binding in bindings if binding.handle in self._items]
        for some in batches(items, min(BATCH, self._session.limits.monitor)):
            await self._session.delete_monitored_items(self._id, list(some))

    @property
    def grace(self) -> float:
        """Seconds that a change takes to be reported."""
        return self.sampling + 2.0 * self.publishing

    def check(self) -> None:
        """Raise what is wrong with the subscription as LinkError."""
        if self.fault is not None:
            raise self.fault
        silence = self._clock.monotonic() - self.last_sign
        if silence > self._stale_after:
            raise LinkError(
                f"{self._session.url}: no notification and no keep-alive for {silence * 1000:.0f} ms; "
                f"expected one within stale_after_ms, {self._stale_after * 1000:g}"
            )

    def close(self) -> None:
        """Stop publishing; the server drops the subscription with the session."""
        for worker in self._workers:
            worker.cancel()

    def _keep_alive_count(self, publishing: float) -> int:
        return max(1, int(min(self._stale_after / 3.0, SLOWEST_KEEP_ALIVE) / publishing))

    async def _create(self) -> ua.CreateSubscriptionResult:
        """A subscription that publishes as often as the last one did, or as asked, and says in time that it lives."""
        count = self._keep_alive_count(self.publishing)
        result = await self._session.create_subscription(
            ua.CreateSubscriptionParameters(
                RequestedPublishingInterval=self.publishing * 1000.0,
                RequestedLifetimeCount=_lifetime_count(count, self.publishing),
                RequestedMaxKeepAliveCount=count,
                MaxNotificationsPerPublish=MAX_NOTIFICATIONS,
                PublishingEnabled=True,
                Priority=0,
            )
        )
        self._id = result.SubscriptionId
        self.publishing = result.RevisedPublishingInterval / 1000.0
        return result

    async def _publish(self) -> None:
        acknowledgements: list[ua.SubscriptionAcknowledgement] = []
        try:
            while self.fault is None:
                if self._take_changes is None:
                    self._slow.messages += 1
                    response = await self._session.publish(acknowledgements)
                    with link_errors(f"{self._session.url}: Publish"):
                        acknowledgements = self._take(response)
                else:
                    body = await publish(self._session, acknowledgements)
                    acknowledgements = self._take_body(body, self._take_changes)
        except LinkError as error:
            code = getattr(error.__cause__, "code", None)
            if code == ua.StatusCodes.BadTooManyPublishRequests and len(self._workers) > 1:
                return  # the server takes fewer at a time; the others go on
            self.fault = self.fault or error  # the first is the cause, as that a report went missing is not
            self.news.set()

    def _ended(self, worker: "asyncio.Task[None]") -> None:
        """A worker is done; one that a defect ended ends the connection, for what it had to deliver is lost."""
        self._workers.discard(worker)
        error = None if worker.cancelled() else worker.exception()
        if error is not None:
            self.fault = LinkError(f"{self._session.url}: a report could not be taken: {error!r}")
            self.news.set()

    def _take_body(self, body: bytes, take_changes: TakeChanges) -> list[ua.SubscriptionAcknowledgement]:
        """As `_take`; what is no plain message of changes goes to asyncua's decoder."""
        message = read_published(body)
        if message is not None:
            with link_errors(f"{self._session.url}: Publish"):
                try:
                    self._check(message.subscription, message.number, keep_alive=message.keep_alive)
                    if not message.keep_alive:
                        take_changes(body, message, self._clock.monotonic())
                except OddBodyError:
                    message = None
        if message is not None:
            return self._acknowledge(message.subscription, message.number, keep_alive=message.keep_alive)
        self._slow.messages += 1
        with link_errors(f"{self._session.url}: Publish"):
            return self._take(decode_message(ua.PublishResponse, body))

    def _take(self, response: ua.PublishResponse) -> list[ua.SubscriptionAcknowledgement]:
        """Deliver what a publish response brings; returns what to acknowledge."""
        parameters = response.Parameters
        message = parameters.NotificationMessage
        notifications = message.NotificationData or []
        taken = self._acknowledge(
            parameters.SubscriptionId, int(message.SequenceNumber), keep_alive=not notifications
        )
        for notification in notifications:
            if isinstance(notification, ua.StatusChangeNotification):
                raise LinkError(f"{self._session.url}: the subscription ended: {notification.Status.name}")
            if isinstance(notification, ua.DataChangeNotification):
                self._deliver_newest(notification.MonitoredItems or [])
        return taken

    def _acknowledge(
        self, subscription: int, number: int, *, keep_alive: bool
    ) -> list[ua.SubscriptionAcknowledgement]:
        """Take notice of a message; returns what to acknowledge. Raises LinkError when one before it is missing."""
        self._check(subscription, number, keep_alive=keep_alive)
        self.last_sign = self._clock.monotonic()
        if keep_alive:
            return []
        self.news.set()
        self._next_number = 1 if number == 0xFFFFFFFF else number + 1
        return [ua.SubscriptionAcknowledgement(SubscriptionId=self._id, SequenceNumber=number)]

    def _check(self, subscription: int, number: int, *, keep_alive: bool) -> None:
        if subscription != self._id:
            raise LinkError(f"{self._session.url}: subscription {subscription} reports, which is not ours")
        if not keep_alive and self._next_number is not None and number != self._next_number:
            raise LinkError(
                f"{self._session.url}: notification {self._next_number} is missing, {number} came; a change is lost"
            )

    def _deliver_newest(self, items: Sequence[ua.MonitoredItemNotification]) -> None:
        """Items of one tag are in the order of their sampling, so the last one is the newest."""
        newest = {item.ClientHandle: item.Value for item in items}
        self.skipped += len(items) - len(newest)
        for handle, data in newest.items():
            self.skipped += overflowed(data)
            self._deliver(handle, data, self.last_sign)


def _with_timestamp() -> ua.DataChangeFilter:
    """Without a filter a value that is sampled anew and did not change is not reported (OPC 10000-4, 7.22.2)."""
    return ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)


def _lifetime_count(keep_alive_count: int, publishing: float) -> int:
    """At least three keep-alives, as the standard demands (OPC 10000-4, 5.14.2), and LIFETIME."""
    return max(3 * keep_alive_count, int(LIFETIME / publishing) + 1)
