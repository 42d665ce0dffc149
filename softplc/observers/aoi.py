"""The Logix AOI: two-state constant-velocity Kalman observer with scalar arithmetic, batch over axes."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from softplc.interfaces import Observer
from softplc.kernel.batch import aoi as batch
from softplc.model import Model
from softplc.observers.axes import AxisPlace
from softplc.observers.kernel import Flags, Given, Numbers
from softplc.observers.observer import AxisObserver


class Bleed(Model):
    """Velocity damping near rest (paper, equation 22): below the threshold the velocity is multiplied each scan."""

    threshold: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit"})]
    """|measurement − corrected position| below which the velocity bleeds, axis unit. Bigger bleeds more often."""
    factor: Annotated[float, Field(gt=0, lt=1)]
    """What the velocity is multiplied by in each such scan. Bigger bleeds more slowly."""


class AoiConfig(Model):
    """The AOI's observer with its tuning. Variances are per update, in the axis' unit (`unit: mm` makes mm)."""

    type: Literal["aoi"]
    precision: Literal["lreal", "real"] = "lreal"
    """lreal: float64. real: every operation rounded to float32, as a Logix REAL computes."""
    q_x: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "unit²"})] = 0.001
    """Process noise added to the position variance in each scan, unit². Bigger follows faster and smooths less."""
    q_x_dot: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "(unit/s)²"})] = 0.1
    """Process noise added to the velocity variance in each scan, (unit/s)². Bigger: velocity adapts faster."""
    r_x: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit²"})]
    """Measurement noise variance of each sample, unit². Bigger smooths more and lags more."""
    bleed: Bleed | None = None
    """Velocity damping near rest; leave it out for none."""

    @model_validator(mode="after")
    def _fits_the_precision(self) -> Self:
        if self.precision == "real":
            tiny, most = float(np.finfo(np.float32).tiny), float(np.finfo(np.float32).max)
            for name, least in (("q_x", 0.0), ("q_x_dot", 0.0), ("r_x", tiny)):
                value = getattr(self, name)
                if not least <= value <= most:
                    raise ValueError(f"{name} {value:g} does not fit a REAL, expected {least:.3g} to {most:.3g}")
        return self

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type, self.precision)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS")

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning, named as the AOI names its inputs."""
        return ("q_x", "q_x_dot", "r_x", "BleedEnable", "BleedThresh", "BleedFactor")

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["AoiConfig"]) -> Observer:
        """One observer that steps all these axes; `configs` has one entry for each place.

        Raises ValueError when the configurations differ in their `group_key`, or the axes' blocks in their tags.
        """
        if len(places) != len(configs) or len({config.group_key for config in configs}) != 1:
            raise ValueError("expected one configuration for each axis, all with the same group_key")
        kernel = AoiKernel(configs)
        return AxisObserver(places, kernel.dtype, kernel)


class AoiKernel:
    """The AOI of n axes of the same precision."""

    def __init__(self, configs: Sequence[AoiConfig]) -> None:
        self.dtype = np.dtype(np.float32 if configs[0].precision == "real" else np.float64)
        bleeds = [config.bleed for config in configs]
        self._tuning = batch.AoiTuning(
            self.dtype,
            q_x=[config.q_x for config in configs],
            q_x_dot=[config.q_x_dot for config in configs],
            r_x=[config.r_x for config in configs],
            BleedEnable=[bleed is not None for bleed in bleeds],
            BleedThresh=[bleed.threshold if bleed else 0.0 for bleed in bleeds],
            BleedFactor=[bleed.factor if bleed else 1.0 for bleed in bleeds],
        )
        self.tuning: Mapping[str, Numbers] = vars(self._tuning)
        self._state = batch.AoiBatchState(len(configs), self.dtype)
        self._dt_ms = np.zeros(len(configs))

    @property
    def init(self) -> Flags:
        """Which axes have started."""
        return self._state.init

    @property
    def estimates(self) -> Mapping[str, Numbers]:
        """Leaf → the state's own array."""
        state = self._state
        return {
            "Position": state.y,
            "Velocity": state.y_dot,
            "Innovation": state.y_res,
            "S": state.S,
            "K0": state.K0,
            "K1": state.K1,
            "P00": state.P0,
            "P01": state.P1,
            "P11": state.P3,
        }

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan; the AOI takes its time step in milliseconds."""
        np.multiply(given.dt, 1000.0, out=self._dt_ms)
        return batch.step(
            self._state, self._tuning, EnableIn=given.enable, x=given.z, dt=self._dt_ms, rows=given.rows
        )

    def finite(self) -> Flags:
        """Axes without NaN and infinity in the state."""
        return self._state.finite()

    def clear(self, rows: Flags) -> None:
        """Forget everything about these axes."""
        self._state.clear(rows)

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """Equations (2) and (3)."""
        return self._state.y + self._state.y_dot * dt, self._state.y_dot
