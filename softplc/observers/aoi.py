"""The Logix AOI: two-state constant-velocity Kalman observer with scalar arithmetic, batch over axes."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from softplc.interfaces import Observer
from softplc.kernel.batch import aoi as batch
from softplc.model import Model
from softplc.observers.axes import AxisPlace, AxisSpec
from softplc.observers.group import AxisGroup
from softplc.tags import DataType, Image, Role, Tag
from softplc.timing import Scan
from softplc.units import per_second, squared


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

    def tuning_tags(self, spec: AxisSpec) -> tuple[Tag, ...]:
        """The tuning as tags, named as the AOI names its inputs."""
        unit, speed = spec.unit, per_second(spec.unit)

        def tag(leaf: str, unit: str, description: str, data_type: DataType = DataType.DOUBLE) -> Tag:
            return Tag(f"{spec.name}.{leaf}", unit, description, Role.TUNING, data_type)

        return (
            tag("q_x", squared(unit), "Process noise of the position, per scan"),
            tag("q_x_dot", squared(speed), "Process noise of the velocity, per scan"),
            tag("r_x", squared(unit), "Measurement noise, per sample"),
            tag("BleedEnable", "", "Velocity damping near rest", DataType.BOOLEAN),
            tag("BleedThresh", unit, "Deviation below which the velocity bleeds"),
            tag("BleedFactor", "", "What the velocity is multiplied by in each such scan"),
        )

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["AoiConfig"]) -> Observer:
        """One observer that steps all these axes; `configs` has one entry for each place.

        Raises ValueError when the configurations differ in their `group_key`, or the axes' blocks in their tags.
        """
        return AoiObserver(places, configs)


class AoiObserver:
    """Steps the AOI of every axis of the group in one call into the kernel."""

    def __init__(self, places: Sequence[AxisPlace], configs: Sequence[AoiConfig]) -> None:
        if len(places) != len(configs) or len({config.group_key for config in configs}) != 1:
            raise ValueError("expected one configuration for each axis, all with the same group_key")
        dtype = np.float32 if configs[0].precision == "real" else np.float64
        bleeds = [config.bleed for config in configs]
        self._tuning = batch.AoiTuning(
            dtype,
            q_x=[config.q_x for config in configs],
            q_x_dot=[config.q_x_dot for config in configs],
            r_x=[config.r_x for config in configs],
            BleedEnable=[bleed is not None for bleed in bleeds],
            BleedThresh=[bleed.threshold if bleed else 0.0 for bleed in bleeds],
            BleedFactor=[bleed.factor if bleed else 1.0 for bleed in bleeds],
        )
        self._state = state = batch.AoiBatchState(len(places), dtype)
        self._group = AxisGroup(
            places,
            dtype,
            kernel=(state.y, state.y_dot, state.y_res, state.S, state.K0, state.K1, state.P0, state.P1, state.P3),
            tuning=vars(self._tuning),
        )
        self._dt_ms = np.zeros(len(places))

    @np.errstate(all="ignore")
    def step(self, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Advance every axis by one scan: latched `inputs` in, the axes' blocks of `outputs` out."""
        group, state = self._group, self._state
        group.begin(scan, inputs, state.init)
        np.multiply(group.time.dt, 1000.0, out=self._dt_ms)  # the AOI takes milliseconds
        results = batch.step(
            state,
            self._tuning,
            EnableIn=group.enable.state,
            x=group.samples.z,
            dt=self._dt_ms,
            rows=group.time.rows,
        )
        finite = state.finite()
        if not finite.all():
            state.clear(~finite)  # they start again with the next usable sample
        group.finish(scan, outputs, results, finite)

    def command(self, index: int, value: float) -> bool:
        """Take a written value for the tag at this index of `outputs`; False when it is none of the writable ones."""
        return self._group.enable.command(index, value)

    def park(self, outputs: Image) -> None:
        """Mark the estimates of every axis Bad: this observer failed and runs no more."""
        self._group.park(outputs)
