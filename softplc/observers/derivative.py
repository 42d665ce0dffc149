"""The DERIVATIVE example block of IEC 61131-3: the velocity from four samples; the position passes through."""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from softplc.kernel.batch import derivative as batch
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.observer import AxisObserver
from softplc.observers.rows import RowsKernel


class DerivativeConfig(Model):
    """The standard's DERIVATIVE block. As printed it believes in a nominal cycle; `dt_mode: measured` cures that."""

    type: Literal["derivative"]
    precision: Literal["lreal", "real"] = "lreal"
    """lreal: float64. real: every operation rounded to float32, as the block's REAL computes."""
    dt_mode: Literal["nominal", "measured"] = "nominal"
    """nominal: CYCLE is what `cycle_ms` says, as in the standard. measured: the last three measured steps."""
    cycle_ms: Annotated[float, Field(gt=0, le=3_600_000)] | None = None
    """nominal: the block's CYCLE, ms. Where the task runs slower than this, the velocity reads too high."""

    @model_validator(mode="after")
    def _has_its_cycle(self) -> Self:
        if self.dt_mode == "nominal" and self.cycle_ms is None:
            raise ValueError("dt_mode nominal without cycle_ms, expected the block's CYCLE or dt_mode: measured")
        if self.dt_mode == "measured" and self.cycle_ms is not None:
            raise ValueError("cycle_ms with dt_mode measured, which does not use it")
        return self

    tuning_fields: ClassVar[Mapping[str, str]] = {"cycle": "cycle_ms"}

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type, self.precision, self.dt_mode)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ()

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning."""
        return ("cycle",) if self.dt_mode == "nominal" else ()

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["DerivativeConfig"]) -> AxisObserver:
        """One observer that steps all these axes. Raises ValueError when they do not belong together."""
        require_one_group(places, configs)
        dtype = np.dtype(np.float32 if configs[0].precision == "real" else np.float64)
        state = batch.DerivativeBatchState(len(places), dtype)
        tuning = batch.DerivativeTuning(
            dtype,
            cycle=[(config.cycle_ms or 0.0) / 1000.0 for config in configs],
            measured=[config.dt_mode == "measured" for config in configs],
        )
        tuned = {leaf: leaf for leaf in configs[0].tuning}
        return AxisObserver(places, dtype, RowsKernel(state, tuning, batch.step, estimates={}, tuned=tuned))
