"""Subscriptions and monitored items: what is reported, when, and how much of it is kept."""

import logging
import math
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.monitored_item_service import MonitoredItemService
from asyncua.server.subscription_service import SubscriptionService

from softplc.publishers.opcua.values import Watch

_SLOWEST_SAMPLING: Final = 3600.0  # seconds

# asyncua names a logger after every subscription, below this one; unless this one is there, logging's place holder
# for it keeps them all for ever.
logging.getLogger(MonitoredItemService.__module__)


class Subscriptions(SubscriptionService):  # type: ignore[misc]  # asyncua is untyped here
    """asyncua: a publishing interval of NaN never publishes and one of 0 publishes every change on its own; the
    lifetime may be shorter than the keep-alive; Republish of what is not there is answered Good and empty.
    """

    async def create_subscription(
        self, params: Any, callback: Any, session_id: Any, request_callback: Any = None
    ) -> Any:
        """CreateSubscription with a sane interval and lifetime, and softplc's monitored items."""
        limits = self.iserver.limits
        interval = params.RequestedPublishingInterval
        if not interval > limits.min_publishing_ms:  # NaN too
            interval = limits.min_publishing_ms
        params.RequestedPublishingInterval = min(interval, limits.max_publishing_ms)
        keep_alive = self._clamp_keep_alive_count(params.RequestedMaxKeepAliveCount)
        params.RequestedLifetimeCount = max(params.RequestedLifetimeCount, 3 * keep_alive)
        result = await super().create_subscription(params, callback, session_id, request_callback)
        sub = self.subscriptions[result.SubscriptionId]
        sub.most_notifications = params.MaxNotificationsPerPublish
        sub.monitored_item_srv = self.iserver.monitored_items(sub)
        return result

    def transfer(self, session: Any, number: int, callback: Any) -> Any:
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
        sub.session_id, sub.address = session.session_id, session.address
        sub.pub_result_callback, sub.pub_request_callback = callback, session.processor.get_publish_request
        return ua.TransferResult(ua.StatusCode(), sorted(sub._not_acknowledged_results))

    def republish(self, params: Any) -> Any:
        """The message with this sequence number, kept until it is acknowledged. Raises ServiceError."""
        sub = self.subscriptions.get(params.SubscriptionId)
        if sub is None:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)
        kept = sub._not_acknowledged_results.get(params.RetransmitSequenceNumber)
        if kept is None:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        return kept.NotificationMessage


class Sampling:
    """When a monitored item looks at its tag: at `due` or later, then `interval` on (monotonic seconds)."""

    __slots__ = ("due", "index", "interval", "postponed")

    def __init__(self, index: int, interval: float) -> None:
        self.index, self.interval = index, interval
        self.due = -math.inf
        self.postponed = False


class MonitoredItems(MonitoredItemService):  # type: ignore[misc]  # asyncua is untyped here
    """asyncua: every value is deep-copied; a dead band compares with the last value seen instead of the last one
    reported, so that a slow tag never moves; Good→Bad under an absolute dead band raises and is never told; the
    requested sampling interval is ignored; ModifyMonitoredItems with an unknown id raises; deleting n items takes
    n² steps.
    """

    def __init__(self, isub: Any, aspace: Any, watch: Watch) -> None:
        super().__init__(isub, aspace)
        logging.Logger.manager.loggerDict.pop(self.logger.name, None)
        self._watch = watch
        self._sampling: dict[int, Sampling] = {}

    def __len__(self) -> int:
        return len(self._monitored_items)

    async def datachange_callback(self, handle: int, value: Any, error: Any = None) -> None:
        """Report this value when the item's filter and sampling interval say so."""
        mid = self._monitored_datachange.get(handle)
        item = self._monitored_items.get(mid)
        if item is None or item.mode == ua.MonitoringMode.Disabled:
            return
        sampling = self._sampling.get(mid)
        if sampling is not None and not self._samples_now(sampling):
            return
        if not reportable(item.filter, item.mvalue.current_dvalue, value, lambda: self._span(item)):
            return
        item.mvalue.current_dvalue = value
        notification = ua.MonitoredItemNotification(item.client_handle, value)
        await self.isub.enqueue_datachange_event(mid, notification, item.queue_size)

    def _samples_now(self, sampling: Sampling) -> bool:
        watch = self._watch
        if watch.now + watch.interval / 2 < sampling.due:  # half a publish early is nearer than half late
            if not sampling.postponed:
                sampling.postponed = True
                watch.postpone(sampling.index, sampling.due)
            return False
        sampling.postponed = False
        sampling.due = watch.now + sampling.interval
        return True

    async def _create_data_change_monitored_item(self, params: Any) -> Any:
        params.RequestedParameters.Filter = present(params.RequestedParameters.Filter)
        status = self._filter_status(params.RequestedParameters.Filter, params.ItemToMonitor.NodeId)
        if status:
            return ua.MonitoredItemCreateResult(ua.StatusCode(status))
        result = await super()._create_data_change_monitored_item(params)
        item = self._monitored_items.get(result.MonitoredItemId)
        index = self._watch.index.get(params.ItemToMonitor.NodeId)
        if item is None or index is None or params.ItemToMonitor.AttributeId != ua.AttributeIds.Value:
            return result
        self._watch.add(index, stamped=wants_stamps(item.filter))
        self._sampling[result.MonitoredItemId] = sampling = Sampling(index, 0.0)
        result.RevisedSamplingInterval = self._revise_sampling(sampling, params.RequestedParameters.SamplingInterval)
        sampling.due = self._watch.now + sampling.interval
        return result

    def _create_events_monitored_item(self, params: Any) -> Any:
        if not isinstance(params.RequestedParameters.Filter, ua.EventFilter):
            return ua.MonitoredItemCreateResult(ua.StatusCode(ua.StatusCodes.BadEventFilterInvalid))
        return super()._create_events_monitored_item(params)

    def _modify_monitored_item(self, params: Any) -> Any:
        item = self._monitored_items.get(params.MonitoredItemId)
        if item is None:
            return ua.MonitoredItemModifyResult(ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid))
        wanted = params.RequestedParameters
        wanted.Filter = present(wanted.Filter)
        if item.callback_handle is not None:
            status = self._filter_status(wanted.Filter, item.read_value_id.NodeId)
            if status:
                return ua.MonitoredItemModifyResult(ua.StatusCode(status))
            item.filter = wanted.Filter
        item.client_handle = wanted.ClientHandle
        item.queue_size = self._revise_queue_size(wanted.QueueSize)
        result = ua.MonitoredItemModifyResult()
        result.RevisedQueueSize = item.queue_size
        sampling = self._sampling.get(params.MonitoredItemId)
        if sampling is not None:
            result.RevisedSamplingInterval = self._revise_sampling(sampling, wanted.SamplingInterval)
            sampling.due = min(sampling.due, self._watch.now + sampling.interval)
            if wants_stamps(item.filter):
                self._watch.want_stamps(sampling.index)
        return result

    def _delete_monitored_items(self, mid: int) -> Any:
        item = self._monitored_items.get(mid)
        if item is None or item.callback_handle is None:
            return super()._delete_monitored_items(mid)
        self.aspace.delete_datachange_callback(item.callback_handle)
        self._monitored_datachange.pop(item.callback_handle, None)
        self._monitored_items.pop(mid)
        sampling = self._sampling.pop(mid, None)
        if sampling is not None:
            self._watch.remove(sampling.index)
        return ua.StatusCode()

    def _revise_queue_size(self, requested: int) -> int:
        return int(min(max(requested, 1), self.isub.max_queue_size))

    def _revise_sampling(self, sampling: Sampling, requested: float) -> float:
        """Set the interval to what was asked, ms, and return what it became; negative means as published."""
        if requested < 0:
            requested = self.isub.data.RevisedPublishingInterval
        wanted = requested / 1000.0 if math.isfinite(requested) else 0.0
        sampling.interval = min(wanted, _SLOWEST_SAMPLING) if wanted > self._watch.interval else 0.0
        return (sampling.interval or self._watch.interval) * 1000.0

    def _filter_status(self, flt: Any, node_id: Any) -> int:
        """0 when the filter can be served, else the status that says why not."""
        kinds = (ua.DeadbandType.None_, ua.DeadbandType.Absolute, ua.DeadbandType.Percent)
        if flt is None:
            return 0
        if not isinstance(flt, ua.uaprotocol_auto.DataChangeFilter) or flt.DeadbandType not in kinds:
            return int(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
        if flt.DeadbandType == ua.DeadbandType.None_:
            return 0
        if not 0.0 <= flt.DeadbandValue < math.inf:
            return int(ua.StatusCodes.BadDeadbandFilterInvalid)
        if flt.DeadbandType == ua.DeadbandType.Percent and self._range_of(node_id) is None:
            return int(ua.StatusCodes.BadFilterNotAllowed)
        return 0

    def _span(self, item: Any) -> float:
        found = self._range_of(item.read_value_id.NodeId)
        return math.inf if found is None else float(found.High - found.Low)

    def _range_of(self, node_id: Any) -> Any:
        """EURange of a tag; None where it has none."""
        if node_id not in self._watch.index:
            return None
        name = ua.NodeId(f"{node_id.Identifier}.EURange", node_id.NamespaceIndex)
        value = self.aspace.read_attribute_value(name, ua.AttributeIds.Value).Value
        return None if value is None else value.Value


def reportable(flt: Any, reported: Any, new: Any, span: Any) -> bool:
    """A monitored item with this DataChangeFilter (None: status and value) reports `new` after `reported`.

    OPC 10000-4, 7.22.2: `span()` is the width of EURange, for a dead band in percent. A change of status is always
    reported; a dead band only holds back numbers.
    """
    if reported is None or reported.StatusCode.value != new.StatusCode.value:
        return True
    trigger = ua.DataChangeTrigger.StatusValue if flt is None else flt.Trigger
    if trigger == ua.DataChangeTrigger.Status:
        return False
    old_value, new_value = reported.Value.Value, new.Value.Value
    banded = flt is not None and flt.DeadbandType != ua.DeadbandType.None_
    if old_value == new_value or (old_value != old_value and new_value != new_value):  # noqa: PLR0124  NaN
        stamped = trigger == ua.DataChangeTrigger.StatusValueTimestamp and not banded
        return stamped and bool(reported.SourceTimestamp != new.SourceTimestamp)
    if not banded or not all(isinstance(value, int | float) for value in (old_value, new_value)):
        return True
    band = flt.DeadbandValue
    if flt.DeadbandType == ua.DeadbandType.Percent:
        band *= span() / 100.0
    return not abs(new_value - old_value) <= band  # NaN is reported


def present(flt: Any) -> Any:
    """The filter; None for the empty ExtensionObject that says there is none."""
    return None if isinstance(flt, ua.ExtensionObject) and flt.TypeId.is_null() else flt


def wants_stamps(flt: Any) -> bool:
    """The filter's trigger names the source timestamp."""
    return flt is not None and flt.Trigger == ua.DataChangeTrigger.StatusValueTimestamp
