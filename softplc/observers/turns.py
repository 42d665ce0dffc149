"""Rotary axes: the observer's state stays within a turn, and so does what is published."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from softplc.observers.axes import AxisPlace
from softplc.observers.kernel import Flags, Kernel
from softplc.observers.published import Published
from softplc.observers.signal import Signal

_POSITIONS: Final = ("Position", "PositionNow")


class Turns:
    """The axes of a group whose `signal` has a `modulo`. Their positions are in [0, modulo)."""

    def __init__(self, places: Sequence[AxisPlace]) -> None:
        turns = [place.spec.signal.modulo if place.spec.signal else None for place in places]
        self._rows = np.flatnonzero([turn is not None for turn in turns])
        self._turn = np.array([turn for turn in turns if turn is not None])
        self._shifted: Flags = np.zeros(len(places), np.bool_)
        self._by = np.zeros(len(places))

    def shift(self, kernel: Kernel, signal: Signal | None) -> None:
        """Take whole turns off the state after a step, so that it loses no precision however long the axis turns."""
        position = kernel.estimates["Position"][self._rows]
        turns = np.floor(position / self._turn)
        if not turns.any():
            return
        np.copyto(turns, 0.0, where=~np.isfinite(turns))
        self._by[self._rows] = -turns * self._turn
        np.not_equal(self._by, 0.0, out=self._shifted)
        kernel.shift(self._shifted, self._by)
        if signal is not None:
            signal.shift(self._by)

    def wrap(self, tags: Published) -> None:
        """What is published is within the turn also where it is predicted, and where rounding reaches its end."""
        for leaf in _POSITIONS:
            if leaf in tags:
                values = tags.row(leaf)
                within = np.mod(values[self._rows], self._turn)
                values[self._rows] = np.where(within >= self._turn, 0.0, within)
