"""The motion of a body between stops: it hits them, and bounces or stays. Exact, with a contact to tell."""

import math
from functools import lru_cache
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, model_validator

from softplc.model import Model

_MOST_IMPACTS = 10_000  # in one cycle


class Bounce(Model):
    """Leaves the lower stop, and comes back by gravity or from an upper stop; an impact leaves κ of its speed.

    With gravity it is a ball, or an axis that is pushed against its stop; without, it moves at constant velocity. The
    first time that it is at the lower stop after `repeat_s` it is sent off again with the full velocity.
    """

    type: Literal["bounce"]
    velocity: Annotated[float, Field(gt=0)]
    """Velocity with which it leaves the lower stop, unit/s."""
    restitution: Annotated[float, Field(ge=0, le=1)] = 0.5
    """κ: an impact turns velocity v into −κ·v. 0 stays at the lower stop, 1 loses nothing."""
    lower: float = 0.0
    """Position of the lower stop, unit."""
    upper: float | None = None
    """Position of the upper stop, unit; leave it out for none, which needs gravity."""
    gravity: Annotated[float, Field(ge=0)] = 0.0
    """Acceleration towards the lower stop, unit/s²; 0 for constant velocity."""
    repeat_s: Annotated[float, Field(gt=0, le=86_400)] = 10.0
    """Time after which it is sent off again, s."""
    contact_s: Annotated[float, Field(ge=0, le=3600)] = 0.1
    """How long the contact stays closed after an impact, s; at rest on the stop it is always closed."""

    @model_validator(mode="after")
    def _comes_back(self) -> "Bounce":
        if self.upper is not None and not self.upper > self.lower:
            raise ValueError(f"upper: found {self.upper:g}, expected more than lower, which is {self.lower:g}")
        if self.upper is None and self.gravity == 0:
            raise ValueError("gravity: found 0, expected more, or an upper stop: it would never come back")
        if self.upper is not None and self.gravity == 0 and self.restitution == 0:
            raise ValueError("restitution: found 0, expected more, or gravity: it would stay at the upper stop")
        if len(_flights(self)) >= _MOST_IMPACTS:
            raise ValueError(f"repeat_s: found {self.repeat_s:g}, expected fewer than {_MOST_IMPACTS} impacts in it")
        return self

    def at(self, t: float) -> tuple[float, float]:
        """Position and velocity at t seconds; at an impact the velocity is that after it."""
        flight, elapsed = self._flight(t)
        return _fly(flight, elapsed, self.gravity)

    def contact(self, t: float) -> bool:
        """Whether the contact is closed at t seconds: at rest, and for contact_s after each impact but the start."""
        flight, elapsed = self._flight(t)
        return flight.rests or (elapsed < self.contact_s and elapsed < t)

    @property
    def _cycle(self) -> float:
        return _flights(self)[-1].end

    def _flight(self, t: float) -> tuple["_Flight", float]:
        """The flight that t lies in, and the time since it began."""
        flights = _flights(self)
        phase = math.fmod(t, self._cycle)
        low, high = 0, len(flights) - 1
        while low < high:
            middle = (low + high) // 2
            if phase < flights[middle].end:
                high = middle
            else:
                low = middle + 1
        return flights[low], phase - flights[low].start


class _Flight(NamedTuple):
    """From one impact to the next: times within the cycle, and position and velocity where it begins."""

    start: float
    end: float
    position: float
    velocity: float

    @property
    def rests(self) -> bool:
        return self.velocity == 0.0


def _fly(flight: _Flight, t: float, gravity: float) -> tuple[float, float]:
    if flight.rests:
        return flight.position, 0.0
    return flight.position + flight.velocity * t - 0.5 * gravity * t * t, flight.velocity - gravity * t


@lru_cache(maxsize=1024)
def _flights(motion: Bounce) -> tuple[_Flight, ...]:
    """The flights of one cycle, the last of which ends where it is sent off again."""
    flights: list[_Flight] = []
    now, position, velocity = 0.0, motion.lower, motion.velocity
    while len(flights) < _MOST_IMPACTS:
        time, hit = _next_impact(motion, position, velocity)
        flights.append(_Flight(now, now + time, position, velocity))
        now, position = now + time, hit
        if hit == motion.lower and now >= motion.repeat_s:
            break
        _, speed = _fly(flights[-1], time, motion.gravity)
        velocity = -motion.restitution * speed
        if position == motion.lower and velocity <= 1e-4 * motion.velocity:  # a ball's bounces have no end otherwise
            flights.append(_Flight(now, max(now, motion.repeat_s), motion.lower, 0.0))
            break
    return tuple(flights)


def _next_impact(motion: Bounce, position: float, velocity: float) -> tuple[float, float]:
    """Time until the next stop, and which one it is."""
    g, upper = motion.gravity, motion.upper
    if g == 0.0:
        stop = motion.lower if velocity < 0.0 or upper is None else upper
        return (stop - position) / velocity, stop
    if upper is not None and velocity > 0.0 and velocity * velocity >= 2.0 * g * (upper - position):
        root = math.sqrt(velocity * velocity - 2.0 * g * (upper - position))
        return (velocity - root) / g, upper
    root = math.sqrt(velocity * velocity + 2.0 * g * (position - motion.lower))
    return (velocity + root) / g, motion.lower
