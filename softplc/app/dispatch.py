"""What clients wrote, judged a second time in the scan process: the gateway is where a stranger may have got in."""

import math
from collections.abc import Sequence
from typing import Final

import structlog

from softplc.clock import Clock
from softplc.exchange import Writer
from softplc.log_limit import LogLimit
from softplc.scan import CyclicTask
from softplc.tags import DataType, Image, Tag, TagTable

_WHOLE: Final = {
    DataType.BOOLEAN: (0.0, 1.0),
    DataType.UINT16: (0.0, 65535.0),
    DataType.UINT32: (0.0, 2.0**32 - 1),
    DataType.INT64: (-(2.0**63), 2.0**63 - 1024),
}
"""What a value of a whole number may be to fit."""

log = structlog.get_logger(__name__)


class Commands:
    """Hands what clients wrote to the observers, before they step; `refused` counts what it did not."""

    def __init__(self, table: TagTable, image: Image, writer: Writer, clock: Clock) -> None:
        self.tasks: Sequence[CyclicTask] = ()
        self._table, self._image, self._writer, self._clock = table, image, writer, clock
        self._refused = 0
        self._senseless = 0
        self._limit = LogLimit()

    @property
    def refused(self) -> int:
        """Commands that no observer took, and rings that made no sense, since start."""
        return self._refused + self._writer.refused

    def dispatch(self) -> None:
        """Give every command to its observer. Each that is not as the tag allows is refused and told."""
        for index, value in self._writer.commands():
            known = 0 <= index < len(self._table)
            reason = refusal(self._table.tags[index], value) if known else "no such tag"
            if reason:
                self._refuse(self._table.tags[index].name if known else str(index), value, reason)
            else:
                self._take(index, value)
        if self._writer.refused != self._senseless:
            self._senseless = self._writer.refused
            self._tell("commands refused", reason="the ring of commands makes no sense; is the gateway sound?")

    def _take(self, index: int, value: float) -> None:
        tag, old = self._table.tags[index].name, float(self._image.values[index])
        try:
            taken = any(observer.command(index, value) for task in self.tasks for observer in task.observers)
        except Exception as error:  # an observer's defect must not end the scan
            self._refuse(tag, value, repr(error))
            return
        if not taken:
            self._refuse(tag, value, "no such value for this tag")
        elif value != old:
            log.info("tag changed by a client", tag=tag, old=old, new=value)

    def _refuse(self, tag: str, value: float, reason: str) -> None:
        self._refused += 1
        self._tell("command refused", tag=tag, value=value, reason=reason)

    def _tell(self, event: str, **fields: object) -> None:
        room = self._limit.ask(self._clock.monotonic())
        if room is not None:
            log.warning(event, **fields, **room)


def refusal(tag: Tag, value: float) -> str:
    """Why a tag cannot take this value, in words; empty when it can."""
    if not tag.writable:
        return "not writable"
    if not math.isfinite(value):
        return "not finite"
    limits = tag.limits or tag.range
    if limits is not None and not limits[0] <= value <= limits[1]:
        return f"outside {limits[0]:g} … {limits[1]:g}"
    whole = _WHOLE.get(tag.data_type)
    if whole is not None and not (whole[0] <= value <= whole[1] and value == math.floor(value)):
        return f"no {tag.data_type.value}"
    return ""
