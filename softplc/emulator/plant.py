"""The plant: step number to true and measured state of every axis. Pure: no clock, and no memory of past steps.

```
t_k = k · period
truth        (p, v)(t_k)           motion, exact
measurement  z_k = q(p(t_k) + η_k)  η_k seeded noise, q rounds to multiples of the quantum
count        c_k = round(z_k · counts_per_unit), wrapped to 32 bits
```
"""

import math
from dataclasses import dataclass

from softplc.emulator.bounce import Bounce
from softplc.emulator.faults import Fault, Reading
from softplc.emulator.noise import Stream
from softplc.emulator.program import AoiOutputs
from softplc.emulator.scenario import EmulatedAxis, Scenario
from softplc.sample import StatusCode


@dataclass(frozen=True, slots=True)
class AxisState:
    """One axis in one step; positions in its unit, velocity in unit/s.

    `position` is the measurement with raw OPC UA `status`, `count` what the encoder counts; their source
    timestamp is the time of step `measured_in`, an earlier one when the sensor is frozen. `contact` is that of a
    limit switch at the stops, always open on an axis without stops. `aoi`: what the PLC's program made of it,
    where it has one.
    """

    true_position: float
    true_velocity: float
    position: float
    count: int
    status: int
    measured_in: int
    contact: bool = False
    aoi: AoiOutputs | None = None


@dataclass(frozen=True, slots=True)
class PlantStep:
    """All axes in step `number`, in the order of the scenario."""

    number: int
    axes: tuple[AxisState, ...]


class Plant:
    """The axes of a scenario. `at` gives any step, in any order, always the same."""

    def __init__(self, scenario: Scenario) -> None:
        self._axes = tuple(_AxisPlant(axis, scenario) for axis in scenario.axes)

    def at(self, number: int) -> PlantStep:
        """Step `number`, counted from 0."""
        return PlantStep(number, tuple(axis.at(number) for axis in self._axes))


class _AxisPlant:
    def __init__(self, axis: EmulatedAxis, scenario: Scenario) -> None:
        self._axis = axis
        self._period = scenario.period
        self._period_ms = scenario.period_ms
        self._noise = Stream(scenario.seed, axis.name, axis.noise.draw)
        self._faults: tuple[tuple[Fault, Stream], ...] = tuple(
            (fault, Stream(scenario.seed, f"{axis.name}.faults.{index}", lambda random, count: random.random(count)))
            for index, fault in enumerate(axis.faults)
        )

    def at(self, number: int) -> AxisState:
        position, velocity = self._truth(number)
        reading = self._healthy(number)
        for fault, chance in self._faults:
            begin = fault.begin(number, self._period)
            if begin is not None and chance.at(number) < fault.probability:
                reading = fault.apply(reading, begin, self._healthy)
        count = wrapped(reading.encoder * self._axis.counts_per_unit)
        return AxisState(
            position, velocity, reading.value, count, reading.status, reading.step, self._contact(number)
        )

    def _truth(self, number: int) -> tuple[float, float]:
        return self._axis.motion.at(number * self._period_ms / 1000.0)

    def _contact(self, number: int) -> bool:
        motion = self._axis.motion
        return isinstance(motion, Bounce) and motion.contact(number * self._period_ms / 1000.0)

    def _healthy(self, number: int) -> Reading:
        value = quantised(self._truth(number)[0] + self._noise.at(number), self._axis.quantum)
        return Reading(value, value, StatusCode.GOOD, number)


def quantised(value: float, quantum: float | None) -> float:
    """The nearest multiple of the quantum; the value itself without one."""
    return value if quantum is None else round(value / quantum) * quantum


def wrapped(counts: float) -> int:
    """The nearest integer as a signed 32-bit counter shows it: one more than 2³¹ − 1 is −2³¹."""
    return (math.floor(counts + 0.5) + 2**31) % 2**32 - 2**31
