"""How long the main algorithm takes here, path by path, as in Tables A1 and A2 and in A.3 of the DUCEKF paper."""

import gc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.reference.dhvpo import TABLE_1, Dhvpo, PlantRule, PlantState, plant_step
from softplc.kernel.reference.ducekf import DucekfInputs, ducekf, ducekf_start

Clock = Callable[[], int]  # nanoseconds, monotonic

ITERATIONS = 350
ROUTES_US = {1: 0.2, 2: 0.2, 3: 243.0, 4: 252.0, 5: 0.8, 6: 0.8}  # the paper's, A.2
PROCESSES_US = (248.0, 67_932.0, 120.0)  # the paper's, Table A1
_REPEATS = 101


@dataclass(frozen=True, slots=True)
class Path:
    """A run of iterations `first`…`last` that took the same routes; `here_us` is the median of the measured ones."""

    first: int
    last: int
    routes: tuple[int, ...]
    here_us: float

    @property
    def quantity(self) -> int:
        """Iterations in it."""
        return self.last - self.first + 1

    @property
    def paper_us(self) -> float:
        """The sum of the paper's routes."""
        return sum(ROUTES_US[route] for route in self.routes)


@dataclass(frozen=True, slots=True)
class Statistics:
    """Mean in µs, variance in µs² and standard deviation in µs over all iterations, as A.3 defines them."""

    mean: float
    variance: float
    deviation: float


@dataclass(frozen=True, slots=True)
class Timing:
    """`times` are µs, one row for each repetition of the 350 iterations; `output_us` is packing four DAC words."""

    times: NDArray[np.float64]
    paths: list[Path]
    paper: Statistics
    here: Statistics
    output_us: float

    def typical(self) -> NDArray[np.float64]:
        """The median of each iteration over the repetitions, in µs: what is left when the machine is left alone."""
        return np.asarray(np.median(self.times, axis=0))


def measure(clock: Clock) -> Timing:
    """Run the 350 iterations of Table 1 again and again and time each of them: plant and filter, steps 9 to 19."""
    routes = [one[0] for one in _once(clock)]
    collecting = gc.isenabled()
    gc.disable()  # a collection in the middle would be timed as if the algorithm had taken it
    try:
        times = np.array([[one[1] for one in _once(clock)] for _ in range(_REPEATS)]) / 1000.0
        output = _time_output(clock)
    finally:
        if collecting:
            gc.enable()
    typical = np.median(times, axis=0)
    paths = []
    for taken, group in groupby(range(ITERATIONS), key=lambda index: routes[index]):
        members = list(group)
        paths.append(Path(members[0] + 1, members[-1] + 1, taken, float(np.median(typical[members]))))
    return Timing(times, paths, paper_statistics(paths), _statistics(typical), output)


def _once(clock: Clock) -> list[tuple[tuple[int, ...], int]]:
    """Routes and nanoseconds of each iteration."""
    model, rule, dt = Dhvpo(), PlantRule(), 0.01
    plant, state = PlantState(0.0, 1.5), ducekf_start(0.0, 1.8, (0.2, 0.0, 0.0, 0.2), 0.0)
    found = []
    for _ in range(ITERATIONS):
        start = clock()
        plant, contact = plant_step(model, rule, plant, dt)
        state, _ = ducekf(model, TABLE_1, state, DucekfInputs(True, plant.x1, dt, float(contact)))
        found.append((state.routes, clock() - start))
    return found


def _time_output(clock: Clock) -> float:
    """Packing the four states for the converter, in µs; no bus is here that could send them."""
    times = []
    for _ in range(_REPEATS):
        start = clock()
        dac_words((0.5, -1.5, 0.5, -1.5))
        times.append(clock() - start)
    return float(np.median(times)) / 1000.0


DAC_SPAN = 3.0  # the states lie within ±3


def dac_words(states: Sequence[float]) -> bytes:
    """Words of 24 bits for the converter of section 4.2: 8 bits of channel, 12 of data, 4 of padding.

    The states are shifted to a positive range, −3 … 3 to 0 … 4095; what lies outside is clipped.
    """
    words = bytearray()
    for channel, value in enumerate(states):
        level = min(max(round((value + DAC_SPAN) / (2.0 * DAC_SPAN) * 4095.0), 0), 4095)
        words += bytes((channel, level >> 4, (level & 0xF) << 4))
    return bytes(words)


def paper_statistics(paths: Sequence[Path]) -> Statistics:
    """A.3: mean and variance over the paths, each weighted with its iterations, with the paper's own times."""
    total = sum(path.quantity for path in paths)
    mean = sum(path.quantity * path.paper_us for path in paths) / total
    variance = sum(path.quantity * (path.paper_us - mean) * (path.paper_us - mean) for path in paths) / total
    return Statistics(mean, variance, variance**0.5)


def _statistics(times: NDArray[np.float64]) -> Statistics:
    return Statistics(float(times.mean()), float(times.var()), float(times.std()))
