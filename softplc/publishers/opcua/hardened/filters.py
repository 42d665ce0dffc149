"""What filters of monitored items let through, and how much of it is kept (OPC 10000-4, 7.22.2 and 7.21)."""

from dataclasses import replace
from typing import Any

from asyncua import ua

from softplc.publishers.opcua.fast.queue import OVERFLOW


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


def fit(queue: list[Any], size: int, *, oldest: bool) -> None:
    """Let go of the notifications that are too many: the oldest, or all between the first ones and the newest.

    A queue that lost some and keeps more than one says so: with the overflow bit in its first where the oldest are
    discarded, else in its last, which took the place of the one before.
    """
    over = len(queue) - size
    if over <= 0:
        return
    if oldest:
        del queue[:over]
    else:
        del queue[size - 1 : -1]
    if size > 1:
        marked = 0 if oldest else -1
        queue[marked] = _overflown(queue[marked])


def _overflown(notification: Any) -> Any:
    value = notification.Value
    code = value.StatusCode.value | int(OVERFLOW)
    return replace(notification, Value=replace(value, StatusCode=ua.StatusCode(code)))
