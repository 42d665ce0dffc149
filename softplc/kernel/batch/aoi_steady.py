"""The Logix AOI on arrays in the normal course of things: every axis enabled and initialised, its Δt and S positive.

Each operation on an array costs its call and the way of the rows through the caches. So the rows go part by part,
what is on the way stays in three short buffers, and the state is changed where it is, S being known first. One Δt for
all axes is one number. The operations, each as often as `kernel.reference.aoi` has them, have its order and bits.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy import add, divide, multiply, subtract
from numpy.typing import NDArray

from softplc.kernel.batch.memory import aligned

Numbers = NDArray[Any]
Flags = NDArray[np.bool_]

ROWS = 8000  # at most in a part: with fewer the calls cost more, with more the caches


def slices(n: int) -> list[slice]:
    """The parts of n rows, about as long as each other; one at least."""
    parts = max(1, -(-n // ROWS))
    size = -(-n // parts)
    return [slice(first, min(first + size, n)) for first in range(0, max(n, 1), max(size, 1))]


class StatePart(NamedTuple):
    """Some rows of a state, and the buffers, which all parts share."""

    these: slice
    flag: Flags
    x_cov0: Numbers
    x_cov1: Numbers
    x_cov2: Numbers
    x_pred: Numbers
    y_res: Numbers
    S: Numbers
    x_dot_pred: Numbers
    P0: Numbers
    P1: Numbers
    P2: Numbers
    P3: Numbers
    K0: Numbers
    K1: Numbers
    dt_s: Numbers
    y: Numbers
    y_dot: Numbers


class TuningPart(NamedTuple):
    """Some rows of a tuning."""

    BleedEnable: Flags
    q_x: Numbers
    q_x_dot: Numbers
    r_x: Numbers
    BleedThresh: Numbers
    BleedFactor: Numbers


def tuning_parts(numbers: Numbers, BleedEnable: Flags) -> list[TuningPart]:
    """Those of a tuning with these `numbers` [5, n]."""
    return [TuningPart(BleedEnable[these], *numbers[:, these]) for these in slices(len(BleedEnable))]


class Steady:
    """The normal course for the state with these `numbers` [13, n]."""

    def __init__(self, numbers: Numbers) -> None:
        n, dtype = numbers.shape[1], numbers.dtype
        parts = slices(n)
        size = parts[0].stop
        flag, buffers = np.zeros(size, np.bool_), [aligned((size,), dtype) for _ in range(3)]
        self._parts: list[StatePart] = []
        for these in parts:
            m = these.stop - these.start
            self._parts.append(StatePart(these, flag[:m], *(buffer[:m] for buffer in buffers), *numbers[:, these]))
        self._dtype, self._dt_s = dtype, numbers[10]
        self._one, self._thousand, self._d = np.ones((), dtype), np.full((), 1000.0, dtype), np.zeros((), dtype)

    def step(self, tunings: list[TuningPart], bleeding: bool, x: NDArray[Any], dt: NDArray[Any]) -> list[slice]:
        """One scan of all rows, x in u and dt in ms; the parts that are left to do.

        Those have a dt or an S that is not positive, and as yet nothing was changed in them that a scan of them does
        not write in any case: dt_s, and S where all their dt are positive.
        """
        if x.dtype != self._dtype:
            x = x.astype(self._dtype)
        d = None
        if dt[0] == dt[-1] and np.minimum.reduce(dt) == np.maximum.reduce(dt):
            d = self._d
            d[...] = dt[0]
            divide(d, self._thousand, d)
            if not d > 0.0:
                return [part.these for part in self._parts]
            self._dt_s.fill(d)
        left = []
        for part, tuning in zip(self._parts, tunings, strict=True):
            these, dt_s = part.these, part.dt_s
            if d is None:
                dt_s[...] = dt[these]
                divide(dt_s, self._thousand, dt_s)
                if not np.minimum.reduce(dt_s) > 0.0:  # NaN is not
                    left.append(these)
                    continue
            if not self._part(part, tuning, bleeding, x[these], dt_s if d is None else d):
                left.append(these)
        return left

    def _part(self, part: StatePart, tuning: TuningPart, bleeding: bool, x: Numbers, dt_s: Numbers) -> bool:
        """Equations (2) to (22); False, with no more than S done, when that is not positive in every row."""
        _, flag, x_cov0, x_cov1, x_cov2, x_pred, y_res, S, x_dot_pred, P0, P1, P2, P3, K0, K1, _, y, y_dot = part
        BleedEnable, q_x, q_x_dot, r_x, BleedThresh, BleedFactor = tuning

        multiply(dt_s, P3, x_cov2)
        add(P1, x_cov2, x_cov1)  # also the inner bracket of x_cov0
        add(P2, x_cov2, x_cov2)
        multiply(dt_s, P2, x_cov0)
        add(P0, x_cov0, x_cov0)
        multiply(dt_s, x_cov1, S)  # what will be written anyway serves until then
        add(x_cov0, S, x_cov0)
        add(x_cov0, q_x, x_cov0)
        add(x_cov0, r_x, S)
        if not np.minimum.reduce(S) > 0.0:
            return False

        multiply(dt_s, x_dot_pred, y_res)
        add(x_pred, y_res, x_pred)
        subtract(x, x_pred, y_res)
        divide(x_cov0, S, K0)
        multiply(K0, y_res, y)
        add(x_pred, y, x_pred)
        divide(x_cov2, S, K1)
        multiply(K1, y_res, y_dot)
        add(x_dot_pred, y_dot, x_dot_pred)
        if bleeding:
            subtract(x, x_pred, y)
            np.abs(y, y)
            np.less(y, BleedThresh, flag)
            np.logical_and(flag, BleedEnable, flag)
            multiply(x_dot_pred, BleedFactor, x_dot_pred, where=flag)
        y[...] = x_pred
        y_dot[...] = x_dot_pred

        add(P3, q_x_dot, P3)
        multiply(K1, x_cov1, P2)
        subtract(P3, P2, P3)
        subtract(self._one, K0, P2)
        multiply(P2, x_cov0, P0)
        multiply(P2, x_cov1, P1)
        P2[...] = P1
        return True
