"""The AOI's options as they stand in a configuration, and what they are to the kernel."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from softplc.model import Model

Bounds = tuple[float, float]
_UNLIMITED = (-math.inf, math.inf)
Positive = Annotated[float, Field(gt=0)]


class Bleed(Model):
    """Velocity damping near rest (paper, equation 22): below the threshold the velocity is multiplied each scan.

    With the default gate it also acts on a well-tracked ramp, whose deviation is as small: a velocity of 10 unit/s
    may read 7.
    """

    threshold: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit"})]
    """|measurement − corrected position| below which the velocity bleeds, axis unit. Bigger bleeds more often."""
    factor: Annotated[float, Field(gt=0, lt=1)]
    """What the velocity is multiplied by in each such scan. Bigger bleeds more slowly."""
    bleed_on: Literal["posterior", "innovation"] = "posterior"
    """Which deviation the threshold is for: after the correction, as the AOI's text has it, or the innovation."""
    bleed_gate: Literal["residual", "velocity"] = "residual"
    """residual: wherever the deviation is small. velocity: only where |velocity| is below velocity_limit, too."""
    velocity_limit: Annotated[Positive | None, Field(json_schema_extra={"x-unit": "unit/s"})] = None
    """bleed_gate: velocity: the speed below which the velocity may bleed, unit/s. Bigger bleeds more often."""

    @model_validator(mode="after")
    def _limit_belongs_to_its_gate(self) -> Self:
        if (self.velocity_limit is None) == (self.bleed_gate == "velocity"):
            found = "without" if self.velocity_limit is None else "with"
            expected = "a velocity_limit" if self.velocity_limit is None else "bleed_gate: velocity"
            raise ValueError(f"bleed_gate: {self.bleed_gate} {found} velocity_limit, expected {expected}")
        return self


class GainLimits(Model):
    """Bounds that the gains are held in after they are worked out; both of a pair belong to it."""

    K0: tuple[Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=0, le=1)]] | None = None
    """Lowest and highest gain for the position, 0 to 1."""
    K1: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]] | None = None
    """Lowest and highest gain for the velocity, 1/s. Keep it below (4 − 2·K0)/Δt, where the observer swings up."""

    @model_validator(mode="after")
    def _lowest_first(self) -> Self:
        for name, pair in (("K0", self.K0), ("K1", self.K1)):
            if pair is not None and pair[0] > pair[1]:
                raise ValueError(f"{name} {pair[0]:g} before {pair[1]:g}, expected the lowest first")
        return self

    def pairs(self) -> tuple[Bounds, Bounds]:
        """The bounds of K0 and of K1."""
        return self.K0 or _UNLIMITED, self.K1 or _UNLIMITED


class Gate(Model):
    """Innovation gate: a sample too far from its prediction is not believed. Rejected samples are counted."""

    sigma: Annotated[float, Field(gt=0)] = 5.0
    """A sample is rejected where |innovation| exceeds this many standard deviations √S. Bigger rejects less."""
    most_in_a_row: Annotated[int, Field(ge=0, le=65_535)] = 5
    """So many are rejected in a row; the next one is believed and starts the observer anew. Bigger waits longer."""
