"""How much of what knowing the manoeuvres is worth the adaptive observer recovers, and what it costs elsewhere.

    python bench/adaptive.py [--seeds 40] [--part goal|random-sines|one-tuning|noise|periods|timing|all]

Each track has 1200 scans at 50 ms unless a row says otherwise. Three observers see the same noise:

fixed     the AOI with the best q_x and q_x_dot for this very track, found on realisation 0 over a grid
told      the same AOI, told in which scans the velocity changes: one q_x_dot there, another elsewhere, both the best
adaptive  the adaptive observer: either the machine's data (r_x, speed, acceleration) alone, or these two scaled to
          what is best on realisation 0

All are scored on realisations 1 … seeds. RMSE of position and velocity; "recovered" is how far the adaptive observer
gets from fixed (0 %) to told (100 %). r_x is the true variance of the noise unless a row says otherwise.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softplc.emulator.motion import Motion, RampHold, Sine, Trapezoid
from softplc.kernel.batch import adaptive, aoi

Array = NDArray[np.float64]
Noise = Callable[[np.random.Generator, int], Array]
Score = tuple[float, float]  # RMSE of position, u, and velocity, u/s

SCANS, PERIOD, VARIANCE = 1200, 0.05, 4 / 3


@dataclass(frozen=True)
class Track:
    """A motion, and the speed (u/s) and acceleration (u/s²) of the machine that makes it."""

    name: str
    motion: Motion
    speed: float
    acceleration: float

    def truth(self, times: Array | None = None) -> tuple[Array, Array]:
        """Position and velocity of each scan; at a corner the velocity is that of what begins."""
        at = np.arange(SCANS) * PERIOD if times is None else times
        pairs = np.array([self.motion.at(float(t) + 1e-9) for t in at])  # corners are not exact in binary
        return pairs[:, 0], pairs[:, 1]


def _sine(amplitude: float, period: float) -> tuple[Sine, float, float]:
    omega = 2 * math.pi / period
    return Sine(type="sine", amplitude=amplitude, period_s=period), amplitude * omega, amplitude * omega * omega


FAST, SLOW = (40.0, 80.0), (10.0, 10.0)
CHANGING = (
    Track("ramp–hold, 40 u/s, 7.5 s each", RampHold(type="ramp_hold", slope=40.0, segment_s=7.5), *FAST),
    Track("ramp–hold, 10 u/s, 15 s each", RampHold(type="ramp_hold"), *SLOW),
    Track(
        "trapezoid, 40 u/s, 80 u/s², dwell 3 s",
        Trapezoid(type="trapezoid", distance=200.0, velocity=40.0, acceleration=80.0, dwell_s=3.0),
        *FAST,
    ),
    Track(
        "trapezoid, 10 u/s, 10 u/s², dwell 5 s",
        Trapezoid(type="trapezoid", distance=100.0, velocity=10.0, acceleration=10.0, dwell_s=5.0),
        *SLOW,
    ),
    Track(
        "trapezoid, 40 u/s, 40 u/s², dwell 3 s",
        Trapezoid(type="trapezoid", distance=200.0, velocity=40.0, acceleration=40.0, dwell_s=3.0),
        40.0,
        40.0,
    ),
)


def sine(amplitude: float, period: float, machine: tuple[float, float] | None = None) -> Track:
    """A sine by a machine of that speed and acceleration, or by one that can just do it."""
    motion, *own = _sine(amplitude, period)
    speed, acceleration = machine or own
    name = f"±{amplitude:.0f} u, {period:.0f} s; {speed:.3g}/{acceleration:.3g}"
    return Track(name, motion, speed, acceleration)


SINES = (sine(50.0, 10.0, FAST), sine(10.0, 4.0, FAST), sine(50.0, 30.0, SLOW))
OWN_SINES = tuple(sine(*one) for one in ((50.0, 10.0), (10.0, 4.0), (50.0, 30.0), (30.0, 15.0), (20.0, 20.0)))
SLOW_SINES = tuple(sine(*one, FAST) for one in ((50.0, 30.0), (30.0, 15.0), (20.0, 20.0)))  # by a fast machine
HARD_SINES = (
    *(sine(3.0, 10.0), sine(3.0, 10.0, SLOW), sine(3.0, 10.0, FAST)),  # hardly more than the noise
    sine(10.0, 4.0, SLOW),  # accelerates 2.5 times as hard as the machine is said to
)


def uniform(random: np.random.Generator, count: int) -> Array:
    """U(−2, 2)."""
    return random.uniform(-2.0, 2.0, count)


def gaussian(random: np.random.Generator, count: int) -> Array:
    """Of the same variance."""
    return random.normal(0.0, math.sqrt(VARIANCE), count)


def nothing(_: np.random.Generator, count: int) -> Array:
    """Zeros."""
    return np.zeros(count)


def with_outliers(random: np.random.Generator, count: int) -> Array:
    """U(−2, 2); one sample in fifty lies up to 100 u away."""
    wild = random.random(count) < 0.02
    return np.where(wild, random.uniform(-100.0, 100.0, count), random.uniform(-2.0, 2.0, count))


def measured(truth: Array, noise: Noise, seeds: Iterable[int], step: float = 0.0) -> Array:
    """Measurements [scans, seeds]; `step` quantises them."""
    z = np.stack([truth + noise(np.random.default_rng(seed), len(truth)) for seed in seeds], axis=1)
    return np.round(z / step) * step if step else z


def rmse(estimates: Array, truth: Array) -> Array:
    """Over the scans; estimates [scans, rows]."""
    error = estimates - truth[:, None]
    mean: Array = np.mean(error * error, axis=0)
    return np.sqrt(mean)


def pooled(estimates: tuple[Array, Array], truth: tuple[Array, Array]) -> Score:
    """Over scans and realisations."""
    position, velocity = (float(np.sqrt(np.mean(rmse(e, t) ** 2))) for e, t in zip(estimates, truth, strict=True))
    return position, velocity


def run_aoi(z: Array, q_x: Array, q_x_dot: Array, dt: Array | float = PERIOD, r_x: float = VARIANCE) -> Any:
    """Position and velocity [scans, rows] of the AOI; q_x_dot is [rows] or [scans, rows]."""
    n, rows = len(z), z.shape[1]
    state = aoi.AoiBatchState(rows)
    tuning = aoi.AoiTuning(
        np.float64,
        q_x=np.broadcast_to(q_x, rows),
        q_x_dot=np.zeros(rows),
        r_x=np.full(rows, r_x),
        BleedEnable=np.zeros(rows, np.bool_),
        BleedThresh=np.zeros(rows),
        BleedFactor=np.ones(rows),
    )
    q, dts = np.broadcast_to(q_x_dot, (n, rows)), np.broadcast_to(dt, n) * 1000.0
    every = np.full(rows, True)
    out = np.empty((2, n, rows))
    for k in range(n):
        tuning.q_x_dot[:] = q[k]
        aoi.step(state, tuning, EnableIn=every, x=z[k], dt=np.full(rows, dts[k]), rows=every)
        out[:, k] = state.y, state.y_dot
    return out


def run_adaptive(
    z: Array, speed: Array | float, acceleration: Array | float, dt: Array | float = PERIOD, r_x: float = VARIANCE
) -> Any:
    """Position and velocity [scans, rows] of the adaptive observer."""
    n, rows = len(z), z.shape[1]
    state = adaptive.AdaptiveBatchState(rows)
    tuning = adaptive.AdaptiveTuning(
        r_x=np.full(rows, r_x),
        top_speed=np.broadcast_to(speed, rows),
        top_acceleration=np.broadcast_to(acceleration, rows),
        gate=np.full(rows, 4.0),
    )
    dts, every = np.broadcast_to(dt, n), np.full(rows, True)
    out = np.empty((2, n, rows))
    for k in range(n):
        adaptive.step(state, tuning, EnableIn=every, x=z[k], dt=np.full(rows, dts[k]), rows=every)
        out[:, k] = state.y, state.y_dot
    return out


def grid(*axes: Array) -> tuple[Array, ...]:
    """Every combination, flat."""
    return tuple(axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))


def best(estimates: tuple[Array, Array], truth: tuple[Array, Array]) -> int:
    """The row with the smallest product of both errors."""
    return int(np.argmin(rmse(estimates[0], truth[0]) * rmse(estimates[1], truth[1])))


def tune_fixed(z: Array, truth: tuple[Array, Array], **more: Any) -> tuple[float, float]:
    """q_x and q_x_dot of the best AOI for one realisation [scans]."""
    q_x, q_x_dot = grid(np.array([0.0, 1e-3, 1e-2, 0.1]), np.logspace(-3, 2.5, 56))
    i = best(run_aoi(np.repeat(z[:, None], len(q_x), 1), q_x, q_x_dot, **more), truth)
    return float(q_x[i]), float(q_x_dot[i])


def changes(velocity: Array) -> NDArray[np.bool_]:
    """Scans in which the velocity is another than in the scan before; the first is one."""
    return np.abs(np.diff(velocity, prepend=np.inf)) > 1e-6


def tune_told(z: Array, truth: tuple[Array, Array], **more: Any) -> tuple[float, float]:
    """q_x_dot in scans of change, and in the others, of the best AOI that is told which is which."""
    changing, quiet = grid(np.logspace(-1, 4, 36), np.logspace(-6, 0, 13))
    q = np.where(changes(truth[1])[:, None], changing, quiet)
    i = best(run_aoi(np.repeat(z[:, None], len(quiet), 1), np.zeros(1), q, **more), truth)
    return float(changing[i]), float(quiet[i])


def tune_adaptive(z: Array, truth: tuple[Array, Array], track: Track, **more: Any) -> tuple[float, float]:
    """Speed and acceleration of the best adaptive observer for one realisation, at most 4 × the machine's."""
    factors = np.array([0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0])
    speed, acceleration = grid(track.speed * factors, track.acceleration * factors)
    i = best(run_adaptive(np.repeat(z[:, None], len(speed), 1), speed, acceleration, **more), truth)
    return float(speed[i]), float(acceleration[i])


@dataclass(frozen=True)
class Row:
    """Scores of one track."""

    fixed: Score
    told: Score
    machine: Score
    tuned: Score

    def recovered(self, adaptive: Score) -> Score:
        """Of the distance from fixed to told, position and velocity."""
        position, velocity = ((f - a) / (f - t) for f, t, a in zip(self.fixed, self.told, adaptive, strict=True))
        return position, velocity


@dataclass(frozen=True)
class Case:
    """What differs from U(−2, 2) and 50 ms. `r_x` goes to the adaptive observer; the AOI is tuned for the case."""

    name: str
    noise: Noise = uniform
    step: float = 0.0
    r_x: float = VARIANCE
    jitter: float = 0.0
    period: float = PERIOD


USUAL = Case("U(−2, 2)")
CASES = (
    USUAL,
    Case("Gaussian, same variance", gaussian),
    Case("U(−2, 2), steps of 1 u", step=1.0),
    Case("no noise but steps of 1 u, r_x 1/12", nothing, step=1.0, r_x=1 / 12),
    Case("2 % outliers up to ±100 u", with_outliers),
    Case("r_x 4 × too large", r_x=4 * VARIANCE),
    Case("r_x 4 × too small", r_x=VARIANCE / 4),
    Case("Δt from 25 to 75 ms, measured", jitter=0.5),
)


def row(track: Track, seeds: int, case: Case = USUAL) -> Row:
    """Tuned on realisation 0, scored on 1 … seeds."""
    scans = round(SCANS * PERIOD / case.period)
    dt = case.period * (1.0 + case.jitter * np.random.default_rng(99).uniform(-1.0, 1.0, scans))
    truth = track.truth(np.cumsum(dt) - dt[0])
    first = measured(truth[0], case.noise, [0], case.step)[:, 0]
    z = measured(truth[0], case.noise, range(1, seeds + 1), case.step)
    q_x, q_x_dot = tune_fixed(first, truth, dt=dt)
    changing, quiet = tune_told(first, truth, dt=dt)
    q = np.where(changes(truth[1])[:, None], changing, quiet)
    speed, acceleration = tune_adaptive(first, truth, track, r_x=case.r_x, dt=dt)
    return Row(
        pooled(run_aoi(z, np.array(q_x), np.array(q_x_dot), dt=dt), truth),
        pooled(run_aoi(z, np.zeros(1), q, dt=dt), truth),
        pooled(run_adaptive(z, track.speed, track.acceleration, r_x=case.r_x, dt=dt), truth),
        pooled(run_adaptive(z, speed, acceleration, r_x=case.r_x, dt=dt), truth),
    )


def goal(seeds: int) -> None:
    """The table of the page: changing tracks, then sines."""
    print(f"{'track':40}{'fixed':>14}{'told':>14}{'adaptive':>14}{'recovered':>14}{'tuned':>14}{'recovered':>14}")
    for track in CHANGING:
        one = row(track, seeds)
        print(
            f"{track.name:40}{_pair(one.fixed)}{_pair(one.told)}{_pair(one.machine)}"
            f"{_percent(one.recovered(one.machine))}{_pair(one.tuned)}{_percent(one.recovered(one.tuned))}",
            flush=True,
        )
    print(f"\n{'steady sine; top speed / acceleration':40}{'fixed':>14}", end="")
    print(f"{'':14}{'adaptive':>14}{'loss':>14}{'tuned':>14}{'loss':>14}")
    for track in (*SINES, *OWN_SINES, *SLOW_SINES, *HARD_SINES):
        one = row(track, seeds)
        print(
            f"{track.name:40}{_pair(one.fixed)}{'':14}{_pair(one.machine)}{_percent(_loss(one, one.machine))}"
            f"{_pair(one.tuned)}{_percent(_loss(one, one.tuned))}",
            flush=True,
        )


def random_sines(seeds: int) -> None:
    """Thirty that nothing was tuned on: ±3 … 160 u, 3 … 40 s; every third by a machine that can just do it."""
    random = np.random.default_rng(4711)
    print(f"{'':40}{'fixed':>14}{'adaptive':>14}{'loss':>14}   the machine's speed and acceleration, of the sine's")
    for i in range(30):
        amplitude, period = (float(value) for value in 10 ** random.uniform((0.5, 0.5), (2.2, 1.6)))
        _, speed, acceleration = _sine(amplitude, period)
        more = 10 ** random.uniform((0.0, 0.0), (0.6, 1.6)) if i % 3 else np.ones(2)
        track = sine(amplitude, period, (speed * more[0], acceleration * more[1]))
        truth = track.truth()
        q = tune_fixed(measured(truth[0], uniform, [0])[:, 0], truth)
        z = measured(truth[0], uniform, range(1, seeds + 1))
        fixed = pooled(run_aoi(z, np.array(q[0]), np.array(q[1])), truth)
        ours = pooled(run_adaptive(z, track.speed, track.acceleration), truth)
        share = _percent((ours[0] / fixed[0] - 1.0, ours[1] / fixed[1] - 1.0))
        print(f"{track.name:40}{_pair(fixed)}{_pair(ours)}{share}   × {more[0]:.1f}, × {more[1]:.1f}", flush=True)


def noises(seeds: int) -> None:
    """Other noise, outliers, a wrong r_x, a jittering time step; the machine's data throughout."""
    print(f"{'':40}{'fixed':>14}{'told':>14}{'adaptive':>14}{'recovered':>14}")
    for track in (CHANGING[0], CHANGING[2], SINES[0]):
        print(track.name)
        for case in CASES:
            one = row(track, seeds, case)
            share = _percent(one.recovered(one.machine)) if track in CHANGING else "".rjust(14)
            print(f"  {case.name:38}{_pair(one.fixed)}{_pair(one.told)}{_pair(one.machine)}{share}", flush=True)


def periods(seeds: int) -> None:
    """The same minute and the same noise at other periods; at most ten realisations, for they are long."""
    print(f"{'':40}{'fixed':>14}{'told':>14}{'adaptive':>14}{'recovered':>14}{'loss':>14}")
    for period in (0.01, 0.02, 0.2):
        print(f"{1000 * period:.0f} ms")
        for track in (CHANGING[0], CHANGING[2], CHANGING[4], SINES[0], OWN_SINES[3], SLOW_SINES[1]):
            one = row(track, min(seeds, 10), Case("", period=period))
            share = _percent(one.recovered(one.machine)) if track in CHANGING else "".rjust(14)
            print(
                f"  {track.name:38}{_pair(one.fixed)}{_pair(one.told)}{_pair(one.machine)}{share}"
                f"{_percent(_loss(one, one.machine))}",
                flush=True,
            )


def one_tuning(seeds: int) -> None:
    """A machine is tuned once: both observers as for the first track, on every other one; the best AOI beside."""
    home = CHANGING[0]
    truth = home.truth()
    first = measured(truth[0], uniform, [0])[:, 0]
    q_x, q_x_dot = (np.array(q) for q in tune_fixed(first, truth))
    print(f"{'':40}{'AOI':>14}{'adaptive':>14}{'best AOI':>14}   tuned for: {home.name}")
    for track in (*CHANGING, *SINES):
        truth = track.truth()
        z = measured(truth[0], uniform, range(1, seeds + 1))
        own_q_x, own_q_x_dot = (np.array(q) for q in tune_fixed(measured(truth[0], uniform, [0])[:, 0], truth))
        scores = (
            pooled(run_aoi(z, q_x, q_x_dot), truth),
            pooled(run_adaptive(z, home.speed, home.acceleration), truth),
            pooled(run_aoi(z, own_q_x, own_q_x_dot), truth),
        )
        print(f"{track.name:40}" + "".join(map(_pair, scores)), flush=True)


def timing(_: int) -> None:
    """µs for each axis and scan of the batch; the best of twenty turns of ten scans."""
    for n in (1, 10, 100, 1000, 10_000):
        state = adaptive.AdaptiveBatchState(n)
        tuning = adaptive.AdaptiveTuning(
            r_x=np.ones(n), top_speed=np.full(n, 40.0), top_acceleration=np.full(n, 80.0), gate=np.full(n, 4.0)
        )
        every, dt = np.full(n, True), np.full(n, PERIOD)
        turns = []
        for turn in range(20):
            start = time.perf_counter()
            for k in range(10):
                x = np.full(n, 2.0 * (10 * turn + k))
                adaptive.step(state, tuning, EnableIn=every, x=x, dt=dt, rows=every)
            turns.append((time.perf_counter() - start) / 10)
        print(f"{n:6} axes {min(turns) * 1e6 / n:10.2f} µs each")


def _loss(one: Row, adaptive: Score) -> Score:
    return adaptive[0] / one.fixed[0] - 1.0, adaptive[1] / one.fixed[1] - 1.0


def _pair(score: Score) -> str:
    return f"{score[0]:.2f} / {score[1]:.2f}".rjust(14)


def _percent(score: Score) -> str:
    """A dash where there was next to nothing to recover."""
    parts = [f"{100 * share:.0f}" if abs(share) < 10 else "–" for share in score]
    return f"{' / '.join(parts)} %".rjust(14)


def main() -> None:
    """Print the parts that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--part", choices=[*PARTS, "all"], default="all")
    given = parser.parse_args()
    for name, part in PARTS.items():
        if given.part in (name, "all"):
            start = time.perf_counter()
            part(given.seeds)
            print(f"({time.perf_counter() - start:.0f} s)\n")


PARTS: dict[str, Callable[[int], None]] = {
    "goal": goal,
    "random-sines": random_sines,
    "one-tuning": one_tuning,
    "noise": noises,
    "periods": periods,
    "timing": timing,
}

if __name__ == "__main__":
    main()
