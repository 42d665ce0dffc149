"""The α-β filter: fixed gains, or gains that the tracking index gives for each measured time step."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from softplc.kernel.batch import alpha_beta as batch
from softplc.kernel.batch.coast import alpha_beta_coast
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Flags
from softplc.observers.observer import AxisObserver
from softplc.observers.rows import RowsKernel

_FIXED: Final = ("alpha", "beta")
_INDEXED: Final = ("sigma_w", "sigma_v")
_LEAST: Final = 1e-6
_MOST: Final = 1e6
_STABLE: Final = 2.0  # β below which every α up to 1 is stable, from β < 4 − 2·α


class AlphaBetaConfig(Model):
    """Constant-velocity filter: either `alpha` (and `beta`), or `sigma_w` and `sigma_v` for Kalata's gains."""

    type: Literal["alpha_beta"]
    precision: Literal["lreal", "real"] = "lreal"
    """lreal: float64. real: every operation rounded to float32, as a PLC's REAL computes."""
    alpha: Annotated[float, Field(ge=1e-6, le=1)] | None = None
    """Part of the innovation that goes into the position. Bigger follows faster and smooths less."""
    beta: Annotated[float, Field(ge=1e-12, lt=4)] | None = None
    """Part of the innovation over Δt that goes into the velocity; α²/(2 − α) when left out. Bigger adapts faster."""
    sigma_w: Annotated[float | None, Field(ge=_LEAST, le=_MOST, json_schema_extra={"x-unit": "unit/s²"})] = None
    """Standard deviation of the acceleration, unit/s². Bigger follows faster and smooths less."""
    sigma_v: Annotated[float | None, Field(ge=_LEAST, le=_MOST, json_schema_extra={"x-unit": "unit"})] = None
    """Standard deviation of the measurement, unit. Bigger smooths more and lags more."""

    @model_validator(mode="after")
    def _has_its_gains(self) -> Self:
        given = tuple(name for name in (*_FIXED, *_INDEXED) if getattr(self, name) is not None)
        if given not in (("alpha",), _FIXED, _INDEXED):
            found = " and ".join(given) or "no gains"
            raise ValueError(f"{found}, expected alpha, or alpha and beta, or sigma_w and sigma_v")
        if self.alpha is not None and self.beta is not None and self.beta >= 4.0 - 2.0 * self.alpha:
            raise ValueError(
                f"beta {self.beta:g} is unstable with alpha {self.alpha:g}, expected less than 4 − 2·alpha, "
                f"{4.0 - 2.0 * self.alpha:g}"
            )
        return self

    @property
    def indexed(self) -> bool:
        """The gains come from the tracking index."""
        return self.sigma_w is not None

    @property
    def group_key(self) -> tuple[str | bool, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type, self.precision, self.indexed)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity; fixed gains do not say how large an innovation may be."""
        return ("Innovation", "S", "K0", "K1", "NIS") if self.indexed else ("Innovation", "K0", "K1")

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning."""
        return _INDEXED if self.indexed else _FIXED

    @property
    def limits(self) -> Mapping[str, tuple[float, float]]:
        """Limits of written values: one at a time, so whatever comes second must be stable with what came first.

        Below 2, β is stable with every α; where the configuration has more, α stays below what is stable with that.
        """
        if self.indexed:
            return {}
        beta = self.beta or 0.0
        return {
            "alpha": (_LEAST, 1.0 if beta < _STABLE else math.nextafter(2.0 - 0.5 * beta, 0.0)),
            "beta": (0.0, math.nextafter(_STABLE, 0.0)),
        }

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["AlphaBetaConfig"]) -> AxisObserver:
        """One observer that steps all these axes. Raises ValueError when they do not belong together."""
        require_one_group(places, configs)
        dtype = np.dtype(np.float32 if configs[0].precision == "real" else np.float64)
        state = batch.AlphaBetaBatchState(len(places), dtype)
        alphas = [config.alpha or 0.0 for config in configs]
        tuning = batch.AlphaBetaTuning(
            dtype,
            indexed=[config.indexed for config in configs],
            alpha=alphas,
            beta=[config.beta or a * a / (2.0 - a) for config, a in zip(configs, alphas, strict=True)],
            sigma_w=[config.sigma_w or 0.0 for config in configs],
            sigma_v=[config.sigma_v or 0.0 for config in configs],
        )
        arrays = {"Innovation": "y_res", "S": "S", "K0": "K0", "K1": "K1"}
        kernel = AlphaBetaKernel(
            state,
            tuning,
            batch.step,
            estimates={leaf: arrays[leaf] for leaf in configs[0].estimates if leaf in arrays},
            tuned={leaf: leaf for leaf in configs[0].tuning},
        )
        return AxisObserver(places, dtype, kernel)


class AlphaBetaKernel(RowsKernel):
    """The filters of n axes."""

    _state: batch.AlphaBetaBatchState

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """Equation (1)."""
        alpha_beta_coast(self._state, dt, rows)
        return True
