"""Motions of an axis: true position and velocity as exact functions of time."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from softplc.emulator.bounce import Bounce
from softplc.model import Model

_RAMP_HOLD_LEVELS = (0, 1, 1, 2, 2, 1, 1, 0)  # position at the start of each segment, in ramps
_RAMP_HOLD_SLOPES = (1, 0, 1, 0, -1, 0, -1, 0)


class RampHold(Model):
    """Ramp–hold–ramp–hold, the validation experiment of the paper (eq. 23, Fig. 2).

    With the defaults and a period of 50 ms the first 1200 steps are the canonical 4 × 300: from 0 to 150, hold,
    to 300, hold. It goes on without a jump: the same two ramps and holds downwards, and so on for ever.
    """

    type: Literal["ramp_hold"]
    slope: float = 10.0
    """Velocity of a ramp, unit/s; negative ramps go down first."""
    segment_s: Annotated[float, Field(gt=0, le=86_400)] = 15.0
    """Duration of each ramp and each hold, s."""
    start: float = 0.0
    """Position at the start, unit."""

    def at(self, t: float) -> tuple[float, float]:
        """Position and velocity at t seconds; at a corner the velocity is that of the segment that begins."""
        segment, elapsed = divmod(t, self.segment_s)
        index = int(segment) % len(_RAMP_HOLD_LEVELS)
        velocity = self.slope * _RAMP_HOLD_SLOPES[index]
        return self.start + _RAMP_HOLD_LEVELS[index] * self.slope * self.segment_s + velocity * elapsed, velocity


class Sine(Model):
    """offset + amplitude · sin(2π t / period)."""

    type: Literal["sine"]
    amplitude: float
    """Half of peak to peak, unit."""
    period_s: Annotated[float, Field(gt=0, le=86_400)]
    """Duration of one oscillation, s."""
    offset: float = 0.0
    """Position in the middle, unit."""

    def at(self, t: float) -> tuple[float, float]:
        """Position and velocity at t seconds."""
        omega = 2.0 * math.pi / self.period_s
        phase = omega * math.fmod(t, self.period_s)
        return self.offset + self.amplitude * math.sin(phase), self.amplitude * omega * math.cos(phase)


class Constant(Model):
    """An axis at rest."""

    type: Literal["constant"]
    value: float = 0.0
    """Position, unit."""

    def at(self, t: float) -> tuple[float, float]:
        """The value, and velocity 0."""
        return self.value, 0.0


class Trapezoid(Model):
    """Moves to and fro over a distance with limited velocity and acceleration, and dwells at both ends."""

    type: Literal["trapezoid"]
    distance: float
    """From one end to the other, unit; negative starts downwards."""
    velocity: Annotated[float, Field(gt=0)]
    """Velocity limit, unit/s; a short distance never reaches it."""
    acceleration: Annotated[float, Field(gt=0)]
    """Acceleration and deceleration, unit/s²."""
    dwell_s: Annotated[float, Field(ge=0, le=86_400)] = 1.0
    """Rest at each end, s."""
    start: float = 0.0
    """Position at the start, unit."""

    @model_validator(mode="after")
    def _it_moves(self) -> "Trapezoid":
        if self.distance == 0:
            raise ValueError("distance: found 0, expected another number; an axis at rest is type: constant")
        return self

    def at(self, t: float) -> tuple[float, float]:
        """Position and velocity at t seconds."""
        length = abs(self.distance)
        peak = min(self.velocity, math.sqrt(self.acceleration * length))
        ramp = peak / self.acceleration
        move = length / peak + ramp
        stroke, elapsed = divmod(t, move + self.dwell_s)
        way, speed = _way(min(elapsed, move), length, peak, ramp, move)
        sign = math.copysign(1.0, self.distance)
        if int(stroke) % 2:
            return self.start + sign * (length - way), -sign * speed
        return self.start + sign * way, sign * speed


def _way(t: float, length: float, peak: float, ramp: float, move: float) -> tuple[float, float]:
    """Way and speed t seconds into a move: accelerate for `ramp` seconds, cruise at `peak`, decelerate."""
    if t < ramp:
        return 0.5 * peak / ramp * t * t, peak / ramp * t
    if t <= move - ramp:
        return peak * (t - 0.5 * ramp), peak
    left = move - t
    return length - 0.5 * peak / ramp * left * left, peak / ramp * left


Motion = Annotated[RampHold | Sine | Constant | Trapezoid | Bounce, Field(discriminator="type")]
