"""An axis that fails is parked, that axis alone: it is found among those of its observer, and the others go on."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import structlog

from softplc.observers.axes import AxisPlace
from softplc.observers.join import Part, UnlikeError, join
from softplc.observers.observer import AxisObserver
from softplc.observers.parked import Waiting, together
from softplc.tags import Image
from softplc.timing import Scan

RESTARTS: Final = 3
"""Restarts within `WITHIN` seconds; an axis that fails once more is parked for good."""
WITHIN: Final = 60.0
JOINED: Final = 100
"""Axes that are joined at most: building an observer of more of them takes longer than a scan has to spare."""
PAUSE: Final = 1.0
"""Seconds for which an axis is parked before it is restarted."""

Build = Callable[[Sequence[AxisPlace], Sequence[Any]], AxisObserver]

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Parked:
    """An axis that failed: its observer for tags and commands, and when it may be tried again."""

    observer: AxisObserver
    again_at: float


@dataclass(slots=True)
class _Group:
    """Axes, by number and in their order, that one observer steps together."""

    axes: list[int]
    observer: AxisObserver
    quiet_since: float = -math.inf


class IsolatingObserver:
    """Steps axes in one observer as long as that works; an Observer itself.

    When it raises, halves of its axes are tried with observers of their own, and halves of those that raise, down to
    the axes that raise alone. These are parked; all others go on in one new observer. When none raises alone it was
    the state that they had: they go on in two observers, so that a failure that comes back closes in on its axis.

    A state that was being stepped when somebody raised cannot be trusted, for it may be half stepped. So every axis
    of that observer starts anew and settles as after an outage; what clients have written stays. A parked axis is
    restarted after a pause, alone, so that it fails alone. Small groups that did not fail for a while are joined.
    """

    def __init__(self, places: Sequence[AxisPlace], configs: Sequence[Any], build: Build) -> None:
        self._places, self._configs, self._build = places, configs, build
        every = list(range(len(places)))
        self._groups = [_Group(every, build(places, configs))]
        self._restarts: dict[int, deque[float]] = {}
        self._parked: dict[int, _Parked] = {}
        self._waiting: Waiting | None = None  # what goes on of the parked ones

    def step(self, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Advance every axis by one scan; raises nothing that an axis alone raises."""
        for axis in [axis for axis, parked in self._parked.items() if scan.start >= parked.again_at]:
            self._restart(axis, scan)
        for group in tuple(self._groups):
            try:
                group.observer.step(scan, inputs, outputs)
            except Exception:  # an axis' defect must not end its neighbours
                log.exception("observer failed", axes=len(group.axes), first=self._name(group.axes[0]))
                self._take_apart(group, scan, inputs, outputs)
        if len(self._groups) > 1:
            self._join(scan)
        if self._parked:
            self._waiting = self._waiting or together([parked.observer.waiting for parked in self._parked.values()])
            self._waiting.go_on(scan, outputs)

    def command(self, index: int, value: float) -> bool:
        """Take a written value; an axis that is parked for a while takes it for its restart."""
        parked = [one.observer for one in self._parked.values() if one.again_at < math.inf]
        observers = [*(group.observer for group in self._groups), *parked]
        return any(observer.command(index, value) for observer in observers)

    def park(self, scan: Scan, outputs: Image) -> None:
        """Every axis is parked: the last resort of the scan engine."""
        for group in self._groups:
            group.observer.park(scan, outputs)
        for parked in self._parked.values():
            parked.observer.park(scan, outputs)

    def _take_apart(self, group: _Group, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Find the axes of a group that raised, park them, and step the others on."""
        self._groups.remove(group)
        guilty = self._guilty(group.axes, group, scan, inputs, outputs)
        if not guilty and len(group.axes) == 1:
            guilty = group.axes  # it was the state
        for axis in guilty:
            self._park(axis, group, scan, outputs)
        sound = [axis for axis in group.axes if axis not in set(guilty)]
        half = len(sound) // 2
        for axes in (sound,) if guilty else (sound[:half], sound[half:]):
            if axes:
                self._go_on(axes, group, scan, inputs, outputs)

    def _go_on(self, axes: list[int], group: _Group, scan: Scan, inputs: Image, outputs: Image) -> None:
        observer = self._fresh(axes, group, ramp=True)
        try:
            observer.step(scan, inputs, outputs)
        except Exception:  # each of them is sound by itself
            log.exception("observer failed again", axes=len(axes), first=self._name(axes[0]))
            for axis in axes:
                self._park(axis, group, scan, outputs)
        else:
            self._groups.append(_Group(axes, observer, scan.start))

    def _guilty(self, axes: list[int], group: _Group, scan: Scan, inputs: Image, outputs: Image) -> list[int]:
        """The axes that raise by themselves in this scan, of some that raised together."""
        half, guilty = max(len(axes) // 2, 1), []
        for part in (axes[:half], axes[half:]):
            try:
                if part:
                    self._fresh(part, group, ramp=True).step(scan, inputs, outputs)
            except Exception:  # to find it is what this is for; the first one was logged
                guilty += part if len(part) == 1 else self._guilty(part, group, scan, inputs, outputs)
        return guilty

    def _built(self, axes: list[int]) -> AxisObserver:
        return self._build([self._places[axis] for axis in axes], [self._configs[axis] for axis in axes])

    def _fresh(self, axes: list[int], group: _Group, *, ramp: bool) -> AxisObserver:
        """An observer of these axes that starts anew, with what clients have written."""
        observer = self._built(axes)
        observer.succeed(group.observer, np.searchsorted(group.axes, axes), ramp=ramp)
        return observer

    def _park(self, axis: int, group: _Group, scan: Scan, outputs: Image) -> None:
        observer = self._fresh([axis], group, ramp=False)
        again = _may_restart(self._restarts.setdefault(axis, deque()), scan.start + PAUSE)
        self._parked[axis] = _Parked(observer, scan.start + PAUSE if again else math.inf)
        self._waiting = None
        observer.park(scan, outputs)
        log.error("axis parked", axis=self._name(axis), restart_in=PAUSE if again else "never")

    def _restart(self, axis: int, scan: Scan) -> None:
        log.warning("axis restarted", axis=self._name(axis))
        self._waiting = None
        self._groups.append(_Group([axis], self._parked.pop(axis).observer, scan.start))

    def _join(self, scan: Scan) -> None:
        """Have small groups that were quiet for long stepped as one again, each axis in the state that it has."""
        chosen: list[_Group] = []
        for group in sorted(self._groups, key=lambda group: len(group.axes)):
            few = sum(len(one.axes) for one in chosen) + len(group.axes) <= JOINED
            if few and scan.start - group.quiet_since >= WITHIN:
                chosen.append(group)
        if len(chosen) < 2:
            return
        axes = sorted(axis for group in chosen for axis in group.axes)
        joined = self._built(axes)
        parts = [Part(group.observer, self._built(group.axes), np.searchsorted(axes, group.axes)) for group in chosen]
        try:
            join(joined, parts)
        except UnlikeError as error:
            log.warning("observers not joined", axes=len(axes), reason=str(error))
            for group in chosen:
                group.quiet_since = scan.start
        else:
            log.info("observers joined", axes=len(axes), first=self._name(axes[0]))
            self._groups = [group for group in self._groups if group not in chosen]
            self._groups.append(_Group(axes, joined, scan.start - WITHIN))

    def _name(self, axis: int) -> str:
        return self._places[axis].spec.name


def _may_restart(restarts: deque[float], at: float) -> bool:
    """Whether there were less than the most restarts within the time before `at`; if so, this one is counted."""
    while restarts and restarts[0] <= at - WITHIN:
        restarts.popleft()
    if len(restarts) >= RESTARTS:
        return False
    restarts.append(at)
    return True
