"""The baselines, cv_accel and the AOI on two waveforms: the method tables and the figure of docs/observers.

Usage: .venv/bin/python docs/scripts/baselines.py    renews the tables in the pages and docs/img/baselines.png
       .venv/bin/python docs/scripts/baselines.py --check    writes nothing; fails when a page is out of date
"""

import argparse
import itertools
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from softplc.kernel.batch import alpha_beta, aoi, cv_accel, derivative, finite_difference, moving_average, one_euro

mpl.use("agg")
from matplotlib import pyplot as plt

PAGES = Path(__file__).parents[1] / "observers"
IMAGE = Path(__file__).parents[1] / "img/baselines.png"
BEGIN = "<!-- made by docs/scripts/baselines.py: begin -->\n"
END = "<!-- made by docs/scripts/baselines.py: end -->\n"

DT = 0.05
SLOPE = 10.0
R = 4 / 3  # variance of U(-2, 2)
TUNING_SEED = 0
SCORING_SEEDS = range(1, 21)

Tuning = dict[str, Any]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Wave:
    """True position and velocity, float64[scans], and the page with its table."""

    page: str
    position: Numbers
    velocity: Numbers


def ramp_hold() -> Wave:
    """Ramp, hold, ramp, hold of 15 s each."""
    velocity = np.repeat([SLOPE, 0.0, SLOPE, 0.0], 300)
    return Wave("baselines.md", np.cumsum(velocity * DT), velocity)


def sine() -> Wave:
    """50 u, a period of 8 s, for 60 s: the acceleration reaches 31 u/s²."""
    phase = 2 * np.pi / 8 * DT * np.arange(1200)
    return Wave("cv_accel.md", 50 * np.sin(phase), 50 * 2 * np.pi / 8 * np.cos(phase))


WAVES = (ramp_hold(), sine())


@dataclass(frozen=True)
class Method:
    """One observer with the tunings to choose from; `say` writes one of them in words."""

    name: str
    module: ModuleType
    prefix: str
    grid: list[Tuning]
    say: Callable[[Tuning], str]
    always: Tuning


def grid(**axes: Iterable[float]) -> list[Tuning]:
    """Every combination."""
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


def decades(low: float, high: float, n: int) -> list[float]:
    """n values from 10^low to 10^high, rounded to three digits as a person would write them."""
    return [float(f"{value:.3g}") for value in np.logspace(low, high, n)]


_NO_BLEED = {"BleedEnable": False, "BleedThresh": 0.0, "BleedFactor": 1.0}
_NO_INDEX = {"indexed": False, "sigma_w": 0.0, "sigma_v": 1.0}
METHODS = (
    Method("finite difference", finite_difference, "FiniteDifference", [{}], lambda _: "–", {}),
    Method("DERIVATIVE", derivative, "Derivative", [{"cycle": DT}], lambda _: "50 ms", {"measured": False}),
    Method(
        "moving average",
        moving_average,
        "MovingAverage",
        [{"window": n} for n in range(2, 81)],
        lambda t: f"n = {t['window']}",
        {},
    ),
    Method(
        "α-β, fixed",
        alpha_beta,
        "AlphaBeta",
        grid(alpha=np.linspace(0.04, 0.6, 29).round(2), beta=decades(-4, 0, 33)),
        lambda t: f"α {t['alpha']:g}, β {t['beta']:g}",
        _NO_INDEX,
    ),
    Method(
        "α-β, tracking index",
        alpha_beta,
        "AlphaBeta",
        grid(sigma_w=decades(-1, 3, 61)),
        lambda t: f"σw {t['sigma_w']:g}",
        {"indexed": True, "alpha": 0.0, "beta": 0.0, "sigma_v": np.sqrt(R)},
    ),
    Method(
        "1€",
        one_euro,
        "OneEuro",
        grid(min_cutoff=decades(-2, 1, 13), beta=[0.0, *decades(-3, 0, 7)], d_cutoff=decades(-1.5, 1, 16)),
        lambda t: f"{t['min_cutoff']:g} Hz, β {t['beta']:g}, {t['d_cutoff']:g} Hz",
        {"filtered": False},
    ),
    Method(
        "AOI",
        aoi,
        "Aoi",
        grid(q_x=[0.0, *decades(-4, 0, 9)], q_x_dot=decades(-4, 2, 37)),
        lambda t: f"q_x {t['q_x']:g}, q_x_dot {t['q_x_dot']:g}",
        {"r_x": R, **_NO_BLEED},
    ),
    Method(
        "AOI, 0.01 and 0.1",
        aoi,
        "Aoi",
        [{"q_x": 0.01, "q_x_dot": 0.1}],
        lambda _: "as in the tests",
        {"r_x": R, **_NO_BLEED},
    ),
    Method(
        "cv_accel, white jerk",
        cv_accel,
        "CvAccel",
        grid(q_jerk=decades(-2, 6, 65)),
        lambda t: f"q_jerk {t['q_jerk']:g}",
        {"white_jerk": True, "q_x": 0.0, "q_x_dot": 0.0, "q_x_ddot": 0.0, "r_x": R},
    ),
    Method(
        "cv_accel, per scan",
        cv_accel,
        "CvAccel",
        grid(q_x=[0.0, *decades(-3, 0, 4)], q_x_dot=[0.0, *decades(-3, 1, 9)], q_x_ddot=decades(-5, 2, 15)),
        lambda t: f"{t['q_x']:g}, {t['q_x_dot']:g}, {t['q_x_ddot']:g}",
        {"white_jerk": False, "q_jerk": 0.0, "r_x": R},
    ),
)


def measurements(wave: Wave, seeds: Iterable[int]) -> Numbers:
    """float64[seeds, scans]."""
    n = len(wave.position)
    return np.array([wave.position + np.random.default_rng(seed).uniform(-2, 2, n) for seed in seeds])


def estimates(method: Method, tunings: list[Tuning], z: Numbers) -> tuple[Numbers, Numbers]:
    """Position and velocity float64[rows, scans] for one tuning and one row of z each."""
    n = len(tunings)
    columns = {name: [tuning[name] for tuning in tunings] for name in tunings[0]}
    columns |= {name: [value] * n for name, value in method.always.items()}
    make_tuning = getattr(method.module, f"{method.prefix}Tuning")
    tuning = make_tuning(np.float64, **columns) if columns else make_tuning()
    longest = {"longest": max(columns["window"])} if "window" in columns else {}
    state = getattr(method.module, f"{method.prefix}BatchState")(n, **longest)
    every, dt = np.full(n, True), np.full(n, DT * (1000.0 if method.module is aoi else 1.0))
    y, y_dot = np.empty((2, *z.shape))
    for k in range(z.shape[1]):
        method.module.step(state, tuning, EnableIn=every, x=z[:, k], dt=dt, rows=every)
        y[:, k], y_dot[:, k] = state.y, state.y_dot
    return y, y_dot


def rmse(wave: Wave, y: Numbers, y_dot: Numbers) -> Numbers:
    """Root of the mean squared error over all scans, float64[2, rows]: position in u, velocity in u/s."""
    errors = (y - wave.position, y_dot - wave.velocity)
    return np.array([np.sqrt(np.mean(error * error, axis=1)) for error in errors])


def best(wave: Wave, method: Method) -> tuple[Tuning, Tuning]:
    """The tuning with the least error in position, and in velocity, on the realisation that is tuned on.

    The other error decides between equals.
    """
    z = np.repeat(measurements(wave, [TUNING_SEED]), len(method.grid), axis=0)
    position, velocity = rmse(wave, *estimates(method, method.grid, z)).round(9)
    by_position, by_velocity = np.lexsort((velocity, position))[0], np.lexsort((position, velocity))[0]
    return method.grid[by_position], method.grid[by_velocity]


def scored(wave: Wave, method: Method, tuning: Tuning) -> str:
    """Position and velocity error over the realisations that were not tuned on, as two cells."""
    z = measurements(wave, SCORING_SEEDS)
    errors = rmse(wave, *estimates(method, [tuning] * len(z), z))
    position, velocity = np.sqrt(np.mean(errors * errors, axis=1))
    return f"{position:.2f} | {velocity:.2f}"


def table(wave: Wave) -> tuple[str, dict[str, Tuning]]:
    """The method table in Markdown, and the tuning of each method for velocity."""
    lines = [
        "| method | tuned for position | RMSE u | RMSE u/s | tuned for velocity | RMSE u | RMSE u/s |",
        "|---|---|---|---|---|---|---|",
    ]
    chosen = {}
    for method in METHODS:
        by_position, by_velocity = best(wave, method)
        chosen[method.name] = by_velocity
        cells = (f"{method.say(one)} | {scored(wave, method, one)}" for one in (by_position, by_velocity))
        lines.append(f"| {method.name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n", chosen


def draw(chosen: dict[str, Tuning]) -> None:
    """One row of panels for each method, around the first stop, with the tuning for velocity; a scoring seed."""
    shown = [method for method in METHODS if method.name not in ("AOI, 0.01 and 0.1", "cv_accel, per scan")]
    wave = WAVES[0]
    z = measurements(wave, [SCORING_SEEDS[0]])
    t, window = DT * (1 + np.arange(z.shape[1])), slice(220, 420)
    figure, panels = plt.subplots(len(shown), 2, figsize=(9, 1.35 * len(shown)), sharex=True, sharey="col")
    for (left, right), method in zip(panels, shown, strict=True):
        y, y_dot = estimates(method, [chosen[method.name]], z)
        left.plot(t[window], (z[0] - wave.position)[window], color="0.75", lw=0.8)
        left.axhline(0.0, color="k", lw=0.7)
        left.plot(t[window], (y[0] - wave.position)[window], color="tab:orange", lw=1.2)
        left.set_ylim(-8, 4)
        right.plot(t[window], wave.velocity[window], color="k", lw=0.7)
        right.plot(t[window], y_dot[0, window], color="tab:orange", lw=1.0)
        left.set_ylabel(method.name.replace(", ", "\n"), fontsize=8)
        right.set_ylim(-8, 20)
    panels[0, 0].set_title("error of the position, u (grey: measured)", fontsize=9)
    panels[0, 1].set_title("velocity, u/s (black: true)", fontsize=9)
    for panel in panels.flat:
        panel.tick_params(labelsize=7)
    for panel in panels[-1]:
        panel.set_xlabel("s", fontsize=8)
    figure.tight_layout(h_pad=0.3)
    figure.savefig(IMAGE, dpi=80)
    plt.close(figure)
    Image.open(IMAGE).convert("RGB").quantize(16).save(IMAGE, optimize=True)


def renewed(page: str, lines: str) -> str:
    """The page with its table made anew."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{lines}\n{END}{after}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; fail when a page is out of date")
    check, stale = parser.parse_args().check, []
    for wave in WAVES:
        made, chosen = table(wave)
        page = PAGES / wave.page
        before = page.read_text(encoding="utf-8")
        after = renewed(before, made)
        if check:
            if before != after:
                stale.append(wave.page)
                sys.stdout.write(f"{wave.page} is out of date, it should have\n{made}")
        else:
            page.write_text(after, encoding="utf-8")
            if wave is WAVES[0]:
                draw(chosen)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
