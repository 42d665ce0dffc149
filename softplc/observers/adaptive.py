"""The adaptive observer: one that knows when the motion changes, tuned with the machine's own data."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from softplc.kernel.batch import adaptive as batch
from softplc.kernel.batch.coast import adaptive_coast
from softplc.kernel.result import Result
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Flags, Given, Numbers, StateKernel
from softplc.observers.observer import AxisObserver


class AdaptiveConfig(Model):
    """Tells holding, cruising and manoeuvring apart and filters each as it deserves (docs/observers/adaptive.md)."""

    type: Literal["adaptive"]
    r_x: Annotated[float, Field(ge=1e-18, le=1e18, json_schema_extra={"x-unit": "unit²"})]
    """Measurement noise variance of each sample, unit². A quantised input has at least step²/12."""
    top_speed: Annotated[float, Field(ge=1e-9, le=1e9, json_schema_extra={"x-unit": "unit/s"})]
    """Speed at which the machine travels, unit/s. Bigger believes sudden starts sooner and smooths less."""
    top_acceleration: Annotated[float, Field(ge=1e-9, le=1e9, json_schema_extra={"x-unit": "unit/s²"})]
    """Acceleration with which it gets there, unit/s². Bigger follows changes sooner and smooths less."""
    gate: Annotated[float, Field(ge=2, le=1e6)] = 4.0
    """A sample further than this many standard deviations from everything that may be is left out, three in a row."""

    tuning_fields: ClassVar[Mapping[str, str]] = {"GateSigma": "gate"}

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type,)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return (
            "Acceleration",
            *("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS"),
            *("HoldProbability", "CruiseProbability", "ManoeuvreProbability"),
            "Rejected",
        )

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning."""
        return ("r_x", "top_speed", "top_acceleration", "GateSigma")

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["AdaptiveConfig"]) -> AxisObserver:
        """One observer that steps all these axes; `configs` has one entry for each place.

        Raises ValueError when the configurations differ in their `group_key`, or the axes' blocks in their tags.
        """
        require_one_group(places, configs)
        return AxisObserver(places, np.float64, AdaptiveKernel(configs))


class AdaptiveKernel(StateKernel):
    """The hypotheses of n axes."""

    def __init__(self, configs: Sequence[AdaptiveConfig]) -> None:
        self._tuning = tuning = batch.AdaptiveTuning(
            r_x=[config.r_x for config in configs],
            top_speed=[config.top_speed for config in configs],
            top_acceleration=[config.top_acceleration for config in configs],
            gate=[config.gate for config in configs],
        )
        tuned = {
            "r_x": tuning.r_x,
            "top_speed": tuning.top_speed,
            "top_acceleration": tuning.top_acceleration,
            "GateSigma": tuning.gate,
        }
        self._rejected: NDArray[np.int64] = np.zeros(len(configs), np.int64)  # since the start of the service
        self._state = state = batch.AdaptiveBatchState(len(configs))
        estimates = {
            "Acceleration": state.y_ddot,
            "Innovation": state.y_res,
            "S": state.S,
            "K0": state.K0,
            "K1": state.K1,
            "P00": state.P00,
            "P01": state.P01,
            "P11": state.P11,
            "HoldProbability": state.hold,
            "CruiseProbability": state.cruise,
            "ManoeuvreProbability": state.manoeuvre,
            "Rejected": self._rejected,
        }
        super().__init__(state, estimates, tuned)

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan of the rows; counts the samples that the gate rejected."""
        results = batch.step(
            self._state, self._tuning, EnableIn=given.enable, x=given.z, dt=given.dt, rows=given.rows
        )
        self._rejected += results == Result.REJECTED
        return results

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """Every hypothesis goes on, and new ones are born."""
        adaptive_coast(self._state, self._tuning, dt, rows)
        return True

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """At the estimated acceleration."""
        y, y_dot, y_ddot = self._state.y, self._state.y_dot, self._state.y_ddot
        return y + (y_dot + 0.5 * dt * y_ddot) * dt, y_dot + y_ddot * dt
