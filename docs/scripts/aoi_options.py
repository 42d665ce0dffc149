"""Draws docs/img/aoi-rates.png and aoi-bleed.png with the kernel's own functions.

Usage: PYTHONPATH=. .venv/bin/python docs/scripts/aoi_options.py [--output docs/img]
"""

import argparse
import math
from pathlib import Path

import matplotlib as mpl
import numpy as np

from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.reference.aoi_options import AoiOptions, AoiOptionsState, aoi_options_lreal

mpl.use("agg")
from matplotlib import pyplot as plt

T, Q_X, Q_X_DOT, R_X = 0.05, 0.01, 0.1, 4 / 3  # a tuning that was found at 50 ms
BLUE, GREEN, GREY, ORANGE, BLACK = "#2f6db5", "#3a8f5a", "#8a8a8a", "#e8710a", "#202020"
WHITE = AoiOptions(white_accel=True, r_density=True)
MODES = (  # label, colour, options, q_x, q_x_dot, r_x: all the same observer at 50 ms, or nearly
    ("per_scan, per_sample", GREY, AoiOptions(), Q_X, Q_X_DOT, R_X),
    ("dt, per_sample", BLUE, AoiOptions(q_exponents=(1, 1)), Q_X / T, Q_X_DOT / T, R_X),
    ("dt, density", GREEN, AoiOptions(q_exponents=(1, 1), r_density=True), Q_X / T, Q_X_DOT / T, R_X * T),
    ("white_accel, density, q_x 0", ORANGE, WHITE, 0.0, Q_X_DOT / T, R_X * T),
)


def run(
    xs: np.ndarray,
    dt: float,
    options: AoiOptions,
    tuning: tuple[float, float, float],
    bleed: tuple[bool, float, float] = (False, 0.0, 1.0),
) -> list[AoiOptionsState]:
    """States after each measurement; dt in seconds."""
    state, states = AoiOptionsState(), []
    for x in xs:
        state, _ = aoi_options_lreal(state, AoiInputs(True, float(x), 1000.0 * dt, *tuning, *bleed), options)
        states.append(state)
    return states


def slowest_time_constant(state: AoiOptionsState, dt: float) -> float:
    """Seconds of the slowest pole of the observer with these gains."""
    K0, K1 = state.aoi.K0, state.aoi.K1
    return -dt / math.log(np.abs(np.roots([1.0, -(2.0 - K0 - dt * K1), 1.0 - K0])).max())


def draw_rates(output: Path) -> None:
    """The time constant over the period, and the same stop at three periods as it is and with white acceleration."""
    periods = np.geomspace(0.002, 0.5, 25)
    figure, (tau, plain, white) = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    for label, colour, options, *tuning in MODES:
        settled = [run(np.zeros(round(8 / dt) + 50), dt, options, tuple(tuning))[-1] for dt in periods]
        times = [slowest_time_constant(state, dt) for state, dt in zip(settled, periods, strict=True)]
        tau.plot(1000 * periods, times, color=colour, label=label)
    tau.set_xscale("log")
    tau.set_xlabel("period, ms")
    tau.set_ylabel("slowest time constant, s")
    tau.legend(frameon=False, fontsize=8, loc="upper left")
    for axis, (label, _, options, *tuning) in ((plain, MODES[0]), (white, MODES[3])):
        for dt, style in ((0.01, ":"), (0.05, "-"), (0.2, "--")):
            t = np.arange(round(20 / dt)) * dt
            truth = np.minimum(10.0 * t, 100.0)
            y = np.array([state.aoi.y for state in run(truth, dt, options, tuple(tuning))])
            axis.plot(t - 10.0, y - truth, style, color=BLACK, label=f"{1000 * dt:g} ms", linewidth=1.3)
        axis.set_xlim(-0.5, 4.0)
        axis.set_ylim(-0.4, 3.5)
        axis.set_title(f"stop from 10 u/s: {label}", fontsize=9)
        axis.set_xlabel("time after the stop, s")
        axis.set_ylabel("position minus truth, u")
        axis.legend(frameon=False, fontsize=8)
    for axis in (tau, plain, white):
        axis.grid(alpha=0.25)
    figure.savefig(output / "aoi-rates.png", dpi=72)


def draw_bleed(output: Path) -> None:
    """Velocity on a ramp that stops: without bleed, with it, and with its velocity gate."""
    truth = np.concatenate([0.5 * np.arange(1, 301), np.full(300, 150.0)])
    xs = truth + np.random.default_rng(0).uniform(-2, 2, 1200)[:600]
    bleed = (True, 1.0, 0.9)
    t = T * np.arange(600)
    figure, axis = plt.subplots(figsize=(9, 3.4), layout="constrained")
    for label, colour, options, used in (
        ("no bleed", GREY, AoiOptions(), (False, 0.0, 1.0)),
        ("bleed, threshold 1, factor 0.9", BLUE, AoiOptions(), bleed),
        ("the same with bleed_gate: velocity, velocity_limit 2", ORANGE, AoiOptions(bleed_velocity=2.0), bleed),
    ):
        v = [state.aoi.y_dot for state in run(xs, T, options, (Q_X, Q_X_DOT, R_X), used)]
        axis.plot(t, v, color=colour, label=label, linewidth=1.2)
    axis.plot(t, np.where(t < 15.0, 10.0, 0.0), "--", color=BLACK, linewidth=0.8, label="true")
    axis.set_xlim(5, 25)
    axis.set_ylim(-3, 15)
    axis.set_xlabel("time, s")
    axis.set_ylabel("velocity, u/s")
    axis.legend(frameon=False, fontsize=8, ncols=2)
    axis.grid(alpha=0.25)
    figure.savefig(output / "aoi-bleed.png", dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs/img"))
    output = parser.parse_args().output
    output.mkdir(parents=True, exist_ok=True)
    draw_rates(output)
    draw_bleed(output)


if __name__ == "__main__":
    main()
