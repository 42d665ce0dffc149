"""What is done with a measurement before it becomes one: the axis block `signal`."""

import math
from dataclasses import dataclass
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from softplc.model import Model

Positive = Annotated[float, Field(gt=0, le=1e15, json_schema_extra={"x-unit": "unit"})]
MOST_IN_A_ROW: Final = 3
FASTEST_COUNT: Final = 1e6  # counts a second that no axis exceeds, where nothing is said of its speed


class Signal(Model):
    """Conditioning of the measured position before the observer (docs/signal.md). Leave out what is not needed."""

    counter_bits: Literal[16, 32] | None = None
    """The input is a counter of so many bits that rolls over; Position goes on beyond it, in both directions."""
    modulo: Positive | None = None
    """A rotary axis: one turn, as 360 for degrees. Position is from 0 to below this, velocity knows no wrap."""
    quantum: Positive | None = None
    """Step of the measurement, unit. Dither of one step about rest is no motion; Position may be one step behind."""
    dead_band: Positive | None = None
    """A change of less than this from the last value passed on is none. Bigger is quieter at rest and coarser."""
    max_rate: Annotated[float, Field(gt=0, le=1e15, json_schema_extra={"x-unit": "unit/s"})] | None = None
    """Fastest that the axis can move, unit/s; a sample that is faster is rejected. Bigger lets bigger jumps in."""
    max_rate_samples: Annotated[int, Field(ge=1, le=1000)] = MOST_IN_A_ROW
    """So many rejected in a row, and the next one starts the observer anew where it is. Bigger waits longer."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if not self.model_fields_set - {"max_rate_samples"}:
            raise ValueError(
                "found nothing to do, expected counter_bits, modulo, quantum, dead_band or max_rate, or no signal"
            )
        if self.max_rate is None and "max_rate_samples" in self.model_fields_set:
            raise ValueError("max_rate_samples without max_rate, which rejects the samples, expected both or neither")
        for name in ("quantum", "dead_band"):
            width = getattr(self, name)
            if self.modulo is not None and width is not None and width >= self.modulo / 2.0:
                raise ValueError(
                    f"{name} {width:g} is half of modulo {self.modulo:g} or more, expected a small part of a turn"
                )
        return self

    def spec(self, scale: float, offset: float = 0.0) -> "SignalSpec":
        """As the observers see it; `scale`: unit of the axis for one count of the input tag, `offset`: at count 0."""
        return SignalSpec(
            counter=None if self.counter_bits is None else 2.0**self.counter_bits * abs(scale),
            counter_at_0=offset,
            fastest=self.max_rate or FASTEST_COUNT * abs(scale),
            modulo=self.modulo,
            quantum=self.quantum or 0.0,
            dead_band=self.dead_band or 0.0,
            max_rate=self.max_rate,
            max_rate_samples=self.max_rate_samples,
        )


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """Conditioning of one axis' measurement, in the axis' unit.

    `counter`: span after which the input's counter is where it was; `counter_at_0`: what is read at count 0;
    `fastest`: what the axis cannot exceed, unit/s, to tell whether its counter may have rolled over unseen.
    `modulo`: one turn. `quantum` and `dead_band`: 0 for none. `max_rate` in unit/s; after `max_rate_samples`
    rejected in a row the next sample starts anew.
    """

    counter: float | None = None
    counter_at_0: float = 0.0
    fastest: float = math.inf
    modulo: float | None = None
    quantum: float = 0.0
    dead_band: float = 0.0
    max_rate: float | None = None
    max_rate_samples: int = MOST_IN_A_ROW
