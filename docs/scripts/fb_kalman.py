"""Draws docs/img/fb-kalman-gains.png and fb-kalman-runs.png with the kernel's own functions.

Usage: PYTHONPATH=. .venv/bin/python docs/scripts/fb_kalman.py [--output docs/img]
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from softplc.kernel.reference import fb_kalman as kernel
from softplc.kernel.reference.fb_kalman import FbKalmanInputs, FbKalmanState

mpl.use("agg")
from matplotlib import pyplot as plt

WRITTEN, CORRECTED, GREY = "#2f6db5", "#e8710a", "#8a8a8a"
Q, R, DT = 0.1, 1.0, 0.1  # the example program's
Call = Callable[[FbKalmanState, FbKalmanInputs], tuple[FbKalmanState, Any]]


def beta_written(alpha: np.ndarray) -> np.ndarray:
    return alpha * (1 - alpha)


def beta_optimal(alpha: np.ndarray) -> np.ndarray:
    return alpha * alpha / (2 - alpha)


def damping(alpha: float, beta: float) -> float:
    """ζ of the slower pole of z² − (2 − α − β)z + (1 − α), mapped to continuous time."""
    s = np.log(np.roots([1.0, -(2.0 - alpha - beta), 1.0 - alpha]).astype(complex))
    return float((-s.real / np.abs(s)).min())


def velocity_noise(alpha: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Standard deviation of Δt·v̂ for white noise of 1."""
    return np.sqrt(2 * beta * beta / (alpha * (4 - 2 * alpha - beta)))


def run(call: Call, xs: Sequence[float], state: FbKalmanState | None = None) -> list[FbKalmanState]:
    """States after each measurement with the example's tuning."""
    state, states = state or FbKalmanState(), []
    for x in xs:
        state, _ = call(state, FbKalmanInputs(x, Q, R, DT))
        states.append(state)
    return states


def draw_gains(output: Path) -> None:
    """β, damping and velocity noise over the position gain."""
    alpha = np.linspace(0.02, 0.98, 193)
    figure, (gain, zeta, noise) = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")

    gain.plot(alpha, beta_written(alpha), color=WRITTEN, label="as written, β = α(1 − α)")
    gain.plot(alpha, beta_optimal(alpha), color=CORRECTED, label="optimal, β = α²/(2 − α)")
    gain.set_ylabel("velocity gain β = Δt·K1")
    gain.set_ylim(0, 1)
    gain.legend(frameon=False, loc="upper left")

    zeta.plot(alpha, [damping(a, b) for a, b in zip(alpha, beta_written(alpha), strict=True)], color=WRITTEN)
    zeta.plot(alpha, [damping(a, b) for a, b in zip(alpha, beta_optimal(alpha), strict=True)], color=CORRECTED)
    zeta.plot(alpha, np.sqrt(alpha) / 2, color=GREY, linestyle="--", linewidth=1)
    zeta.annotate("√K/2", (0.8, 0.36), color=GREY, ha="center")
    zeta.set_ylabel("damping ζ")
    zeta.set_ylim(0, 1.05)

    noise.semilogy(alpha, velocity_noise(alpha, beta_written(alpha)) / velocity_noise(alpha, beta_optimal(alpha)))
    noise.lines[0].set_color(WRITTEN)
    noise.axhline(1, color=CORRECTED)
    noise.semilogy(alpha, 2 / alpha, color=GREY, linestyle="--", linewidth=1)
    noise.annotate("2/K", (0.6, 4.3), color=GREY, ha="center")
    noise.set_ylabel("velocity noise / optimal")

    for axis in (gain, zeta, noise):
        axis.set_xlabel("position gain α = K")
        axis.set_xlim(0, 1)
        axis.grid(alpha=0.25)
    figure.savefig(output, dpi=80)


def draw_runs(output: Path) -> None:
    """A step after the gains have settled, and the first seconds of an object at rest at 10.5."""
    figure, (step, position, velocity) = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    calls = (
        (kernel.fb_kalman_lreal, WRITTEN, "as written"),
        (kernel.fb_kalman_corrected_lreal, CORRECTED, "corrected"),
    )
    for call, colour, label in calls:
        settled = run(call, [0.0] * 400)[-1]
        answer = [0.0] * 5 + [state.x_pos for state in run(call, [1.0] * 75, settled)]
        step.plot(DT * (np.arange(80) - 5), answer, color=colour, label=label)
        start = run(call, [10.5] * 80)
        position.plot(DT * np.arange(1, 81), [state.x_pos for state in start], color=colour)
        velocity.plot(DT * np.arange(1, 81), [state.x_vel for state in start], color=colour)
    step.plot([-0.5, 0, 0, 7.5], [0, 0, 1, 1], color="black", linewidth=0.9, linestyle="--")
    step.set_title("a step, gains settled", fontsize=10)
    position.axhline(10.5, color="black", linewidth=0.9, linestyle="--")
    position.set_title("at rest at 10.5, started at zero: position", fontsize=10)
    velocity.axhline(0, color="black", linewidth=0.9, linestyle="--")
    velocity.set_title("the same: velocity", fontsize=10)
    step.legend(frameon=False, loc="lower right")
    for axis in (step, position, velocity):
        axis.set_xlabel("time, s")
        axis.grid(alpha=0.25)
    figure.savefig(output, dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs/img"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    draw_gains(folder / "fb-kalman-gains.png")
    draw_runs(folder / "fb-kalman-runs.png")


if __name__ == "__main__":
    main()
