"""The 1€ filter: a low pass whose cutoff rises with the speed; the velocity is its low-passed derivative."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from softplc.kernel.batch import one_euro as batch
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.observer import AxisObserver
from softplc.observers.rows import RowsKernel


class OneEuroConfig(Model):
    """Low pass with a cutoff that rises with the speed (Casiez et al. 2012): still at rest, quick in motion."""

    type: Literal["one_euro"]
    min_cutoff: Annotated[float, Field(ge=1e-6, le=1e6, json_schema_extra={"x-unit": "Hz"})] = 1.0
    """Cutoff at rest, Hz. Smaller smooths more at rest and lags more."""
    beta: Annotated[float, Field(ge=0, le=1e9, json_schema_extra={"x-unit": "1/unit"})]
    """Rise of the cutoff with the speed, Hz per unit/s. Bigger lags less in motion and smooths less."""
    d_cutoff: Annotated[float, Field(ge=1e-6, le=1e6, json_schema_extra={"x-unit": "Hz"})] = 1.0
    """Cutoff of the velocity, Hz. Smaller smooths the velocity more and lags more."""
    difference: Literal["measured", "filtered"] = "measured"
    """Against what a new sample is differenced: the last measurement, or as the paper the last filtered position,
    which reads the velocity of a ramp several times too high."""

    tuning_fields: ClassVar[Mapping[str, str]] = {"cutoff_slope": "beta"}

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type,)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ("Cutoff",)

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning."""
        return ("min_cutoff", "cutoff_slope", "d_cutoff")

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["OneEuroConfig"]) -> AxisObserver:
        """One observer that steps all these axes. Raises ValueError when they do not belong together."""
        require_one_group(places, configs)
        state = batch.OneEuroBatchState(len(places))
        tuning = batch.OneEuroTuning(
            min_cutoff=[config.min_cutoff for config in configs],
            beta=[config.beta for config in configs],
            d_cutoff=[config.d_cutoff for config in configs],
            filtered=[config.difference == "filtered" for config in configs],
        )
        kernel = RowsKernel(
            state,
            tuning,
            batch.step,
            estimates={"Cutoff": "cutoff"},
            tuned={"min_cutoff": "min_cutoff", "cutoff_slope": "beta", "d_cutoff": "d_cutoff"},
        )
        return AxisObserver(places, state.dtype, kernel)
