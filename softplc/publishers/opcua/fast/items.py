"""The monitored items of one subscription: those on tags' values are swept, all others are asyncua's."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

from softplc.publishers.opcua.fast.encoding import LARGEST, encode
from softplc.publishers.opcua.fast.queue import Entries, Queue
from softplc.publishers.opcua.fast.sweep import NO_BAND, Sweep, Terms
from softplc.publishers.opcua.hardened.filters import present, wants_stamps
from softplc.publishers.opcua.hardened.items import MonitoredItems, Sampling
from softplc.publishers.opcua.hardened.publishing import Subscription
from softplc.publishers.opcua.values import Watch

_TYPE: Final = ua.FourByteNodeId(ua.ObjectIds.DataChangeNotification_Encoding_DefaultBinary)
_COUNT: Final = 4  # bytes of the number of items, and of that of the diagnostics after them
_NO_DIAGNOSTICS: Final[bytes] = struct_to_binary(ua.DataChangeNotification())[-_COUNT:]
_BESIDE: Final = 4096  # bytes, at most, of all else in a message: of acknowledgements and what they answer


class SweptSubscription(Subscription):
    """A subscription that also publishes what its swept items have to say, as bytes."""

    def has_published_results(self) -> bool:
        """A message is due, with notifications or to keep alive."""
        return self._is_waiting() or bool(super().has_published_results())

    def _is_waiting(self) -> bool:
        return super()._is_waiting() or bool(self._publishing_enabled and self.monitored_item_srv.waiting)

    def _pop_triggered_datachanges(self, result: Any) -> None:
        items = self.monitored_item_srv
        items.sweep.slow += bool(self._triggered_datachanges)
        super()._pop_triggered_datachanges(result)
        told = result.NotificationMessage.NotificationData
        room = self._most() - sum(len(data.MonitoredItems) for data in told)
        if items.waiting and room > 0:
            told.append(ua.ExtensionObject(_TYPE, data_change(items.take(room))))

    def _most(self) -> int:
        """How many notifications the client takes in one message."""
        room = (self.pub_result_callback.__self__.room() - _BESIDE) // LARGEST
        return int(max(min(room, self.most_notifications or room), 1))


class SweptItems(MonitoredItems):
    """Monitored items of a subscription; makes it one that publishes them."""

    def __init__(self, isub: Any, aspace: Any, watch: Watch, sweep: Sweep) -> None:
        super().__init__(isub, aspace, watch)
        isub.__class__ = SweptSubscription
        self.sweep = sweep
        self._queue = Queue()
        self._number = sweep.open(self._queue)
        self._silent = Queue()  # of items that are only sampled: what they will report
        self._silent_number = sweep.open(self._silent)
        self._slots: dict[int, int] = {}
        self._look_at: list[int] = []
        self._gone: list[int] = []

    @property
    def waiting(self) -> int:
        """Notifications that wait."""
        return len(self._queue)

    def take(self, most: int) -> Entries:
        """The first notifications that wait; then they wait no more."""
        return self.sweep.take(self._number, most)

    async def create_monitored_items(self, params: Any) -> list[Any]:
        """CreateMonitoredItems; each new item reports at once."""
        results = await super().create_monitored_items(params)
        self._look()
        return list(results)

    async def set_monitoring_mode(self, mode: Any, ids: Sequence[int]) -> list[Any]:
        """SetMonitoringMode; an item that was disabled reports at once."""
        results = await super().set_monitoring_mode(mode, ids)
        if self._look_at:
            which = np.unique(np.array(self._look_at, np.intp))
            self.sweep.set_mode(which, self._queue_of(mode), active=_looks(mode))
        self._look()
        return list(results)

    def _queue_of(self, mode: Any) -> int:
        return self._silent_number if mode == ua.MonitoringMode.Sampling else self._number

    def delete_monitored_items(self, ids: Sequence[int]) -> list[Any]:
        """DeleteMonitoredItems, and what they had to say."""
        results = super().delete_monitored_items(ids)
        for queue in (self._queue, self._silent):
            queue.pull(np.array(self._gone, np.intp))
        self._gone.clear()
        return list(results)

    def delete_all_monitored_items(self) -> None:
        """The subscription is gone."""
        super().delete_all_monitored_items()
        self.sweep.close(self._number)
        self.sweep.close(self._silent_number)

    async def _create_data_change_monitored_item(self, params: Any) -> Any:
        what, wanted = params.ItemToMonitor, params.RequestedParameters
        index = self._watch.index.get(what.NodeId)
        value = what.AttributeId == ua.AttributeIds.Value
        if index is None or not value or what.IndexRange or what.DataEncoding.Name:
            return await super()._create_data_change_monitored_item(params)
        wanted.Filter = present(wanted.Filter)
        status = self._filter_status(wanted.Filter, what)
        if status:
            return ua.MonitoredItemCreateResult(ua.StatusCode(status))
        result, item = self._make_monitored_item_common(params)
        self._commit_monitored_item(result, item)
        terms, result.RevisedSamplingInterval = self._terms(item, wanted, index)
        queue = self._queue_of(item.mode)
        slot = self._slots[item.monitored_item_id] = self.sweep.add(index, queue, terms, active=_looks(item.mode))
        self._look_at.append(slot)
        return result

    def _modify_monitored_item(self, params: Any) -> Any:
        slot = self._slots.get(params.MonitoredItemId)
        if slot is None:
            return super()._modify_monitored_item(params)
        item, wanted = self._monitored_items[params.MonitoredItemId], params.RequestedParameters
        wanted.Filter = present(wanted.Filter)
        status = self._filter_status(wanted.Filter, item.read_value_id)
        if status:
            return ua.MonitoredItemModifyResult(ua.StatusCode(status))
        item.filter, item.client_handle = wanted.Filter, wanted.ClientHandle
        item.queue_size = self._revise_queue_size(wanted.QueueSize)
        result = ua.MonitoredItemModifyResult()
        result.RevisedQueueSize = item.queue_size
        terms, result.RevisedSamplingInterval = self._terms(
            item, wanted, self._watch.index[item.read_value_id.NodeId]
        )
        self.sweep.modify(slot, terms)
        return result

    async def _set_monitoring_mode(self, mode: Any, mid: int) -> Any:
        slot = self._slots.get(mid)
        if slot is None:
            return await super()._set_monitoring_mode(mode, mid)
        self._monitored_items[mid].mode = mode
        self._look_at.append(slot)
        return ua.StatusCode()

    def _delete_monitored_items(self, mid: int) -> Any:
        slot = self._slots.pop(mid, None)
        if slot is None:
            return super()._delete_monitored_items(mid)
        del self._monitored_items[mid]
        self.sweep.remove(slot)
        self._gone.append(slot)
        return ua.StatusCode()

    def _terms(self, item: Any, wanted: Any, index: int) -> tuple[Terms, float]:
        """What is wanted of an item on this tag, and the revised sampling interval in ms."""
        sampling = Sampling(index, 0.0)
        revised = self._revise_sampling(sampling, wanted.SamplingInterval)
        flt = item.filter
        band = NO_BAND
        if flt is not None and flt.DeadbandType != ua.DeadbandType.None_:
            band = float(flt.DeadbandValue)
            if flt.DeadbandType == ua.DeadbandType.Percent:
                band *= self._span(item) / 100.0
        terms = Terms(
            handle=item.client_handle,
            stamps=int(self._stamps),
            valued=flt is None or flt.Trigger != ua.DataChangeTrigger.Status,
            stamped=wants_stamps(flt) and band == NO_BAND,
            band=band,
            interval=sampling.interval,
            size=item.queue_size,
            oldest=bool(wanted.DiscardOldest),
        )
        return terms, revised

    def _look(self) -> None:
        if self._look_at:
            self.sweep.look(np.unique(np.array(self._look_at, np.intp)))
            self._look_at.clear()


def data_change(entries: Entries) -> bytes:
    """A DataChangeNotification with these entries, in their order."""
    items = encode(
        entries["class"], entries["value"], entries["status"], entries["source"], entries["server"], entries["handle"]
    )
    return len(entries).to_bytes(_COUNT, "little") + items + _NO_DIAGNOSTICS


def _looks(mode: Any) -> bool:
    return bool(mode != ua.MonitoringMode.Disabled)
