"""Three-state Kalman observer: position, velocity and acceleration, with the AOI's guards and scalar arithmetic."""

from collections.abc import Sequence
from typing import Annotated, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from softplc.kernel.batch import cv_accel as batch
from softplc.kernel.batch.coast import cv_accel_coast
from softplc.kernel.result import Result
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Flags, Given, Numbers
from softplc.observers.observer import AxisObserver
from softplc.observers.rows import RowsKernel

_PER_SCAN: Final = ("q_x", "q_x_dot", "q_x_ddot")
_COVARIANCES: Final = ("P00", "P01", "P02", "P11", "P12", "P22")


class CvAccelConfig(Model):
    """Kalman observer with acceleration; follows a ramp and a constant acceleration without error."""

    type: Literal["cv_accel"]
    q_mode: Literal["per_scan", "white_jerk"] = "per_scan"
    """per_scan: q_x, q_x_dot and q_x_ddot are added in each scan, as by the AOI. white_jerk: q_jerk, whatever Δt."""
    q_x: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "unit²"})] = 0.001
    """per_scan: process noise of the position, unit². Bigger follows faster and smooths less."""
    q_x_dot: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "(unit/s)²"})] = 0.01
    """per_scan: process noise of the velocity, (unit/s)². Bigger: velocity adapts faster."""
    q_x_ddot: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "(unit/s²)²"})] = 0.1
    """per_scan: process noise of the acceleration, (unit/s²)². Bigger: acceleration adapts faster."""
    q_jerk: Annotated[float | None, Field(gt=0, json_schema_extra={"x-unit": "unit²/s⁵"})] = None
    """white_jerk: spectral density of the jerk, unit²/s⁵. Bigger follows faster and smooths less."""
    r_x: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit²"})]
    """Measurement noise variance of each sample, unit². Bigger smooths more and lags more."""

    @model_validator(mode="after")
    def _has_the_noise_of_its_mode(self) -> Self:
        if self.q_mode == "per_scan" and self.q_jerk is not None:
            raise ValueError("q_jerk with q_mode per_scan, which does not use it, expected q_mode: white_jerk")
        if self.q_mode == "white_jerk":
            unused = [name for name in _PER_SCAN if name in self.model_fields_set]
            if unused:
                raise ValueError(f"{', '.join(unused)} with q_mode white_jerk, which uses q_jerk alone")
            if self.q_jerk is None:
                raise ValueError("q_mode white_jerk without q_jerk, expected the density of the jerk")
        return self

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type, self.q_mode)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ("Acceleration", "Innovation", "S", "K0", "K1", "K2", *_COVARIANCES, "NIS")

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning."""
        return (*(("q_jerk",) if self.q_mode == "white_jerk" else _PER_SCAN), "r_x")

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["CvAccelConfig"]) -> AxisObserver:
        """One observer that steps all these axes. Raises ValueError when they do not belong together."""
        require_one_group(places, configs)
        kernel = CvAccelKernel(configs)
        return AxisObserver(places, np.float64, kernel)


class CvAccelKernel(RowsKernel):
    """The three-state observers of n axes."""

    _state: batch.CvAccelBatchState
    _tuning: batch.CvAccelTuning

    def __init__(self, configs: Sequence[CvAccelConfig]) -> None:
        tuning = batch.CvAccelTuning(
            r_x=[config.r_x for config in configs],
            q_x=[config.q_x for config in configs],
            q_x_dot=[config.q_x_dot for config in configs],
            q_x_ddot=[config.q_x_ddot for config in configs],
            white_jerk=[config.q_mode == "white_jerk" for config in configs],
            q_jerk=[config.q_jerk or 0.0 for config in configs],
        )
        super().__init__(
            batch.CvAccelBatchState(len(configs)),
            tuning,
            batch.step,
            estimates={
                **{"Acceleration": "x_ddot_pred", "Innovation": "y_res"},
                **{leaf: leaf for leaf in ("S", "K0", "K1", "K2", *_COVARIANCES)},
            },
            tuned={leaf: leaf for leaf in configs[0].tuning},
        )

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan of the rows; where S is not positive the axis starts anew with its next sample.

        The AOI's guard alone would latch: P stays, and S with it.
        """
        results = super().step(given)
        latched = results == Result.S_NOT_POSITIVE
        if latched.any():
            self._state.init[latched] = False
        return results

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """Equations (1) to (10)."""
        cv_accel_coast(self._state, self._tuning, dt, rows)
        return True

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """Equations (1) and (2)."""
        state = self._state
        position = state.y + state.y_dot * dt + state.x_ddot_pred * (0.5 * dt * dt)
        return position, state.y_dot + state.x_ddot_pred * dt
