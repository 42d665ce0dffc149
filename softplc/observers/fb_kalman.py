"""FB_KalmanFilter: the PLC function block as written, bug for bug, or with its arithmetic put right."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from softplc.kernel.batch import fb_kalman as batch
from softplc.kernel.batch.coast import fb_kalman_coast
from softplc.kernel.result import Result
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Flags, Given, StateKernel
from softplc.observers.observer import AxisObserver


class FbKalmanConfig(Model):
    """The function block FB_KalmanFilter with its tuning, as written or corrected (docs/observers/fb_kalman.md)."""

    type: Literal["fb_kalman"]
    variant: Literal["as_written", "corrected"] = "as_written"
    """as_written: bug for bug, oscillates and has a noisy velocity. corrected: the Kalman filter that was meant."""
    start: Literal["zero", "measurement"] | None = None
    """Where an enabled axis starts, at rest. Left out: zero as written, measurement when corrected."""
    precision: Literal["lreal", "real"] = "lreal"
    """lreal: float64. real: every operation rounded to float32, as the block's REAL computes."""
    Q: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "(unit/s)²"})] = 0.1
    """Process noise added to the velocity variance in each scan, (unit/s)². Bigger follows faster."""
    R: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit²"})]
    """Measurement noise variance of each sample, unit². Bigger smooths more and lags more."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.variant == "as_written" and self.start == "measurement":
            raise ValueError("start is measurement, expected zero as the block is written, or variant: corrected")
        if self.precision == "real":
            tiny, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
            for name, least in (("Q", 0.0), ("R", tiny)):
                value = getattr(self, name)
                if not least <= value <= most:
                    raise ValueError(f"{name} {value:g} does not fit a REAL, expected {least:.3g} to {most:.3g}")
        return self

    @property
    def starts_at(self) -> Literal["zero", "measurement"]:
        """`start`, or what follows from the variant."""
        return self.start or ("zero" if self.variant == "as_written" else "measurement")

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type, self.precision, self.variant, self.starts_at)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS")

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning, named as the block names its inputs."""
        return ("Q", "R")

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["FbKalmanConfig"]) -> AxisObserver:
        """One observer that steps all these axes; `configs` has one entry for each place.

        Raises ValueError when the configurations differ in their `group_key`, or the axes' blocks in their tags.
        """
        require_one_group(places, configs)
        kernel = FbKalmanKernel(configs)
        return AxisObserver(places, kernel.dtype, kernel)


class FbKalmanKernel(StateKernel):
    """The block of n axes of the same precision, variant and start."""

    def __init__(self, configs: Sequence[FbKalmanConfig]) -> None:
        first = configs[0]
        self.dtype = np.dtype(np.float32 if first.precision == "real" else np.float64)
        self._tuning = batch.FbKalmanTuning(
            self.dtype,
            Q=[config.Q for config in configs],
            R=[config.R for config in configs],
            variant=first.variant,
            start=first.starts_at,
        )
        self._state = state = batch.FbKalmanBatchState(len(configs), self.dtype)
        estimates = {
            "Innovation": state.y_res,
            "S": state.S,
            "K0": state.KalmanGain,
            "K1": state.k_vel,
            "P00": state.p_11,
            "P01": state.p_12,
            "P11": state.p_22,
        }
        super().__init__(state, estimates, {"Q": self._tuning.Q, "R": self._tuning.R})
        self._rows: Flags = np.zeros(len(configs), np.bool_)
        self._no_time: Flags = np.zeros(len(configs), np.bool_)

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan; where no time has passed the block, which divides by it, is not called."""
        state, no_time = self._state, self._no_time
        np.less_equal(given.dt, 0.0, out=no_time)
        np.logical_and(no_time, given.enable, out=no_time)
        np.logical_and(no_time, given.rows, out=no_time)
        np.greater(given.rows, no_time, out=self._rows)
        results = batch.step(state, self._tuning, EnableIn=given.enable, x=given.z, dt=given.dt, rows=self._rows)
        if no_time.any():
            state.y[no_time] = given.z[no_time]
            state.y_dot[no_time] = 0.0
            results[no_time] = Result.DT_INVALID
        return results

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """The block's prediction step."""
        fb_kalman_coast(self._state, self._tuning, dt, rows)
        return True
