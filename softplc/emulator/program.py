"""The AOI in an emulated PLC as a model, and what the PLC shows of it."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from softplc.model import Model


class AoiProgram(Model):
    """The AOI with its inputs; EnableIn is the axis' Enable, dt the time between the steps that the PLC ran."""

    precision: Literal["lreal", "real"] = "real"
    """lreal: float64. real: float32, as a Logix REAL."""
    q_x: Annotated[float, Field(ge=0)] = 0.001
    """Process noise of the position, unit² per scan."""
    q_x_dot: Annotated[float, Field(ge=0)] = 0.1
    """Process noise of the velocity, (unit/s)² per scan."""
    r_x: Annotated[float, Field(gt=0)] = 1.0
    """Measurement noise, unit² per sample."""


@dataclass(frozen=True, slots=True)
class AoiOutputs:
    """What the PLC shows of it after a step: `dt` in ms, `y` in the axis' unit, `y_dot` in unit/s."""

    enable_in: bool
    dt: float
    y: float
    y_dot: float
