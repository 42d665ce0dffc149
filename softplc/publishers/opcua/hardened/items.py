"""Monitored items: what is reported, when, and how much of it is kept."""

import logging
import math
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.monitored_item_service import MonitoredItemService

from softplc.publishers.opcua.hardened.filters import fit, present, reportable, wants_stamps
from softplc.publishers.opcua.hardened.parts import part_of
from softplc.publishers.opcua.hardened.publishing import Subscription
from softplc.publishers.opcua.hardened.reading import STAMPS
from softplc.publishers.opcua.values import Watch, stamped

_SLOWEST_SAMPLING: Final = 3600.0  # seconds
_NUMBERS: Final = frozenset({*range(2, 12), ua.ObjectIds.Number, ua.ObjectIds.Integer, ua.ObjectIds.UInteger})
"""Data types of the standard that are numbers: SByte to Double, and those above them."""
_REFUSED: Final = (
    ua.StatusCodes.BadIndexRangeInvalid,
    ua.StatusCodes.BadDataEncodingInvalid,
    ua.StatusCodes.BadDataEncodingUnsupported,
)

# asyncua names a logger after every subscription, below this one; unless this one is there, logging's place holder
# for it keeps them all for ever.
logging.getLogger(MonitoredItemService.__module__)


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
    n² steps, and what they had to say is still sent; TimestampsToReturn, IndexRange, DataEncoding and DiscardOldest
    are ignored; a queue that ran over does not say so; an item that is only to be sampled reports.
    """

    def __init__(self, isub: Any, aspace: Any, watch: Watch) -> None:
        super().__init__(isub, aspace)
        isub.__class__ = Subscription
        logging.Logger.manager.loggerDict.pop(self.logger.name, None)
        self._watch = watch
        self._sampling: dict[int, Sampling] = {}
        self._stamps = ua.TimestampsToReturn.Both  # of the request that is being served
        self._held: dict[int, list[Any]] = {}  # what items that are only sampled will report

    def __len__(self) -> int:
        return len(self._monitored_items)

    async def create_monitored_items(self, params: Any) -> list[Any]:
        """CreateMonitoredItems. Raises ServiceError when TimestampsToReturn is none."""
        self._want_timestamps(params)
        return list(await super().create_monitored_items(params))

    def modify_monitored_items(self, params: Any) -> list[Any]:
        """ModifyMonitoredItems; timestamps too are those that are asked for now. Raises ServiceError."""
        self._want_timestamps(params)
        return list(super().modify_monitored_items(params))

    def _want_timestamps(self, params: Any) -> None:
        if params.TimestampsToReturn not in STAMPS:
            raise ServiceError(ua.StatusCodes.BadTimestampsToReturnInvalid)
        self._stamps = params.TimestampsToReturn

    async def datachange_callback(self, handle: int, value: Any, error: Any = None) -> None:
        """Report this value when the item's filter and sampling interval say so."""
        mid = self._monitored_datachange.get(handle)
        item = self._monitored_items.get(mid)
        if item is None or item.mode == ua.MonitoringMode.Disabled:
            return
        sampling = self._sampling.get(mid)
        if sampling is not None and not self._samples_now(sampling):
            return
        found = part_of(value, item.read_value_id)
        if not reportable(item.filter, item.mvalue.current_dvalue, found, lambda: self._span(item)):
            return
        item.mvalue.current_dvalue = found
        queue = self._queues(item.mode).setdefault(mid, [])
        queue.append(ua.MonitoredItemNotification(item.client_handle, stamped(found, item.stamps)))
        fit(queue, item.queue_size, oldest=item.discards_oldest)

    def _queues(self, mode: Any) -> dict[int, list[Any]]:
        """Where an item in this mode puts its notifications; asyncua publishes and replaces the one of them."""
        reporting = mode == ua.MonitoringMode.Reporting
        queues: dict[int, list[Any]] = self.isub._triggered_datachanges if reporting else self._held
        return queues

    async def _set_monitoring_mode(self, mode: Any, mid: int) -> Any:
        """OPC 10000-4, 5.12.1.3: what is disabled forgets what it had to say, and reports anew once it is enabled."""
        item = self._monitored_items.get(mid)
        if item is None:
            return ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid)
        before, item.mode = item.mode, mode
        if item.callback_handle is None or before == mode:
            return ua.StatusCode()
        waiting = self._queues(before).pop(mid, None)
        if mode == ua.MonitoringMode.Disabled:
            item.mvalue.current_dvalue = None
        elif waiting:
            self._queues(mode)[mid] = waiting
        if before == ua.MonitoringMode.Disabled:
            if mid in self._sampling:
                self._sampling[mid].due = -math.inf
            what = item.read_value_id
            await self.trigger_datachange(item.callback_handle, what.NodeId, what.AttributeId)
        return ua.StatusCode()

    def _make_monitored_item_common(self, params: Any) -> tuple[Any, Any]:
        result, item = super()._make_monitored_item_common(params)
        item.stamps, item.discards_oldest = self._stamps, bool(params.RequestedParameters.DiscardOldest)
        return result, item

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
        what = params.ItemToMonitor
        found = part_of(self.aspace.read_attribute_value(what.NodeId, what.AttributeId), what).StatusCode.value
        status = found if found in _REFUSED else self._filter_status(params.RequestedParameters.Filter, what)
        if status:
            return ua.MonitoredItemCreateResult(ua.StatusCode(status))
        result = await super()._create_data_change_monitored_item(params)
        item = self._monitored_items.get(result.MonitoredItemId)
        index = self._watch.index.get(what.NodeId)
        if item is None or index is None or what.AttributeId != ua.AttributeIds.Value:
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
            status = self._filter_status(wanted.Filter, item.read_value_id)
            if status:
                return ua.MonitoredItemModifyResult(ua.StatusCode(status))
            item.filter = wanted.Filter
        item.client_handle = wanted.ClientHandle
        item.queue_size = self._revise_queue_size(wanted.QueueSize)
        item.stamps, item.discards_oldest = self._stamps, bool(wanted.DiscardOldest)
        fit(self._queues(item.mode).get(params.MonitoredItemId, []), item.queue_size, oldest=item.discards_oldest)
        result = ua.MonitoredItemModifyResult()
        result.RevisedQueueSize = item.queue_size
        result.RevisedSamplingInterval = self.isub.data.RevisedPublishingInterval
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
        self._queues(item.mode).pop(mid, None)
        sampling = self._sampling.pop(mid, None)
        if sampling is not None:
            self._watch.remove(sampling.index)
        return ua.StatusCode()

    def _revise_queue_size(self, requested: int) -> int:
        return int(min(max(requested, 1), self.isub.max_queue_size))

    def _revise_sampling(self, sampling: Sampling, requested: float) -> float:
        """Set the interval to the whole number of publishes that is nearest to what was asked, ms, and return it.

        Negative means as the subscription publishes, which later changes of that do not change (OPC 10000-4, 7.21).
        """
        if requested < 0:
            requested = self.isub.data.RevisedPublishingInterval
        wanted = min(requested / 1000.0, _SLOWEST_SAMPLING) if math.isfinite(requested) else 0.0
        publishes = max(round(wanted / self._watch.interval), 1)
        sampling.interval = publishes * self._watch.interval if publishes > 1 else 0.0
        return round(publishes * self._watch.interval * 1000.0, 6)

    def _filter_status(self, flt: Any, what: Any) -> int:
        """0 when the filter can be served on this attribute, else the status that says why not."""
        kinds = (ua.DeadbandType.None_, ua.DeadbandType.Absolute, ua.DeadbandType.Percent)
        if flt is None:
            return 0
        if not isinstance(flt, ua.uaprotocol_auto.DataChangeFilter) or flt.DeadbandType not in kinds:
            return int(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
        if flt.DeadbandType == ua.DeadbandType.None_:
            return 0
        percent = flt.DeadbandType == ua.DeadbandType.Percent
        if not 0.0 <= flt.DeadbandValue < math.inf or (percent and flt.DeadbandValue > 100.0):
            return int(ua.StatusCodes.BadDeadbandFilterInvalid)
        if not self._is_number(what) or (percent and self._range_of(what.NodeId) is None):
            return int(ua.StatusCodes.BadFilterNotAllowed)
        return 0

    def _is_number(self, what: Any) -> bool:
        """The attribute is the Value of a variable whose data type is a number; only those have dead bands."""
        if what.AttributeId != ua.AttributeIds.Value:
            return False
        data_type = self.aspace.read_attribute_value(what.NodeId, ua.AttributeIds.DataType).Value
        known = data_type is not None and data_type.Value is not None and data_type.Value.NamespaceIndex == 0
        return known and data_type.Value.Identifier in _NUMBERS

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
