"""What n filters keep and are given: the arrays of `kernel.batch.ducekf`, and the model that it steps."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import add_to
from softplc.kernel.reference.covariance import ImpactCovariance
from softplc.kernel.reference.ducekf import Band, ContactFrom, ImpactScan

Numbers = NDArray[Any]  # float64[n]
Flags = NDArray[np.bool_]

_NUMBERS = ("x1", "x2", "P00", "P01", "P11", "K0", "K1", "S", "y_res")


class Model(Protocol):
    """`kernel.reference.ducekf.Model` on arrays[n], with n sets of parameters."""

    @property
    def kappa(self) -> Numbers:
        """Restitution of each axis."""
        ...

    def f(self, x1: Numbers, x2: Numbers, dt: Numbers) -> tuple[Numbers, Numbers]:
        """The smooth branch, one step of `dt` seconds, (1)."""
        ...

    def jacobian(self, x1: Numbers, x2: Numbers, dt: Numbers) -> tuple[Any, Any, Any, Any]:
        """∂f/∂x at (x1, x2), row-major, (8); an entry that is the same everywhere may be a scalar."""
        ...

    def surface(self, x1: Numbers) -> tuple[Any, Any]:
        """Position of the nearest surface, and its side."""
        ...


class DucekfBatchState:
    """The state of n filters as arrays[n], named as in the reference; P10 is P01."""

    def __init__(self, n: int, dtype: DTypeLike = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        self.init: Flags = np.zeros(n, np.bool_)
        self._numbers: Numbers = np.zeros((len(_NUMBERS), n), self.dtype)
        self.x1, self.x2, self.P00, self.P01, self.P11, self.K0, self.K1, self.S, self.y_res = self._numbers
        self.s0: Numbers = np.full(n, np.nan, self.dtype)
        self.s1: Numbers = np.full(n, np.nan, self.dtype)
        self.armed: Flags = np.zeros(n, np.bool_)
        self.touching: Flags = np.zeros(n, np.bool_)
        self.wait: Numbers = np.full(n, np.nan, self.dtype)
        self.impacts: NDArray[np.int64] = np.zeros(n, np.int64)
        self.y: Numbers = np.zeros(n, self.dtype)
        self.y_dot: Numbers = np.zeros(n, self.dtype)

    def __len__(self) -> int:
        return len(self.init)

    def finite(self) -> Flags:
        """Rows without NaN and infinity in the state."""
        finite: Flags = np.logical_and.reduce(np.isfinite(self._numbers), axis=0)
        return finite

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first scan, but the count of impacts."""
        for flags in (self.init, self.armed, self.touching):
            flags[rows] = False
        for numbers in (*self._numbers, self.y, self.y_dot):
            numbers[rows] = 0.0
        for numbers in (self.s0, self.s1, self.wait):
            numbers[rows] = np.nan

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these rows moves: their positions grow by `by` [n], u. The model's surfaces stay behind."""
        for array in (self.x1, self.s0, self.s1, self.y):
            add_to(array, rows, by)


class DucekfBatchTuning:
    """The tuning of n filters: noise and constraint as arrays[n], the choices the same for all."""

    def __init__(
        self,
        *,
        q_x: ArrayLike,
        q_x_dot: ArrayLike,
        r_x: ArrayLike,
        band: ArrayLike,
        hysteresis: ArrayLike,
        threshold: ArrayLike,
        hold_limit: ArrayLike,
        p_x: ArrayLike,
        p_x_dot: ArrayLike,
        covariance: ImpactCovariance = "omega",
        contact_from: ContactFrom = "tag",
        impact_scan: ImpactScan = "replace",
        edge: Band = "above",
    ) -> None:
        self.q_x, self.q_x_dot, self.r_x = (np.array(value, np.float64) for value in (q_x, q_x_dot, r_x))
        self.band, self.hysteresis = np.array(band, np.float64), np.array(hysteresis, np.float64)
        self.threshold, self.hold_limit = np.array(threshold, np.float64), np.array(hold_limit, np.float64)
        self.p_x, self.p_x_dot = np.array(p_x, np.float64), np.array(p_x_dot, np.float64)
        self.covariance, self.contact_from = covariance, contact_from
        self.impact_scan, self.edge = impact_scan, edge
