"""The Logix AOI: two-state constant-velocity Kalman observer with scalar arithmetic, batch over axes."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from softplc.interfaces import Observer
from softplc.model import Model
from softplc.observers.axes import AxisPlace, AxisSpec
from softplc.tags import DataType, Role, Tag
from softplc.units import per_second, squared


class Bleed(Model):
    """Velocity damping near rest (paper, equation 22): below the threshold the velocity is multiplied each scan."""

    threshold: Annotated[float, Field(gt=0)]
    """|measurement − corrected position| below which the velocity bleeds, in the axis' unit."""
    factor: Annotated[float, Field(gt=0, lt=1)]
    """What the velocity is multiplied by in each such scan."""


class AoiConfig(Model):
    """The AOI's observer with its tuning. Variances are per update, in the axis' unit (`unit: mm` makes mm)."""

    type: Literal["aoi"]
    precision: Literal["lreal", "real"] = "lreal"
    """lreal: float64. real: every operation rounded to float32, as a Logix REAL computes."""
    q_x: Annotated[float, Field(ge=0)] = 0.001
    """Process noise added to the position variance in each scan, unit². Bigger follows faster and smooths less."""
    q_x_dot: Annotated[float, Field(ge=0)] = 0.1
    """Process noise added to the velocity variance in each scan, (unit/s)². Bigger: velocity adapts faster."""
    r_x: Annotated[float, Field(gt=0)]
    """Measurement noise variance of each sample, unit². Bigger smooths more and lags more."""
    bleed: Bleed | None = None
    """Leave out for none."""

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
        """One observer that steps all these axes; `configs` has one entry for each place."""
        raise NotImplementedError
