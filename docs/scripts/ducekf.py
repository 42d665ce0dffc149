"""Draws docs/img/ducekf-paper.png and ducekf-stops.png with the kernel's own functions, and prints their numbers.

Usage: PYTHONPATH=. .venv/bin/python docs/scripts/ducekf.py [--output docs/img]
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib as mpl
import numpy as np

from softplc.kernel.reference import dhvpo
from softplc.kernel.reference.covariance import ImpactCovariance
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, DucekfTuning, ducekf
from softplc.kernel.reference.end_stops import EndStops
from softplc.kernel.result import Result

mpl.use("agg")
from matplotlib import pyplot as plt

TRUE, OURS, OTHER, GREY = "#222222", "#2f6db5", "#e8710a", "#8a8a8a"
COVARIANCES: tuple[ImpactCovariance, ...] = ("omega", "none", "saltation")
NAMES = {"omega": "Ω∘P (paper)", "none": "P unchanged (EKF)", "saltation": "ÃPÃᵀ (saltation)"}
SIGMA, DT, KAPPA, UPPER = 0.5, 0.02, 0.6, 200.0  # mm, s, 1, mm: the slide below
SLIDE = DucekfTuning(
    q_x=0.0,
    q_x_dot=1.0,
    r_x=SIGMA * SIGMA,
    band=4 * SIGMA,
    covariance="saltation",
    impact_scan="within",
    hysteresis=4 * SIGMA,
    hold_limit=0.5,
    p_x=SIGMA * SIGMA,
    p_x_dot=1e4,
)


def draw_paper(output: Path) -> None:
    """Phase portrait with Table 1, and V before and after impacts with κ = 1.5."""
    scans = dhvpo.run(1400)
    figure, (phase, lyapunov) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    phase.plot(*zip(*(scan.x for scan in scans), strict=True), color=TRUE, lw=1.0, label="oscillator")
    phase.plot(*zip(*(scan.x_hat for scan in scans), strict=True), color=OURS, lw=1.4, ls="--", label="DUCEKF")
    phase.set(xlabel="position", ylabel="velocity", title="Table 1: from x̂ = (0, 1.8) to x = (0, 1.5)")
    phase.legend(loc="lower right", frameon=False)

    for covariance, colour, marker in (("none", OTHER, "s"), ("omega", OURS, "o")):
        tuning = replace(dhvpo.TABLE_1, covariance=covariance)
        hits = [scan for scan in dhvpo.run(1000, dhvpo.Dhvpo(kappa=1.5), tuning) if scan.impact]
        print(f"κ = 1.5, {NAMES[covariance]}: ΔV", [f"k = {scan.k}: {scan.delta_v:.2e}" for scan in hits])
        values = [scan.delta_v / (energy(scan) - scan.delta_v) for scan in hits]
        lyapunov.plot([scan.k for scan in hits], values, marker, color=colour, label=NAMES[covariance])
    lyapunov.axhline(0.0, color=GREY, lw=0.8)
    lyapunov.set(
        xlabel="k of the impact", ylabel="ΔV/V", title="κ = 1.5: what an impact adds to V = eᵀPe", ylim=(-0.5, 2)
    )
    lyapunov.legend(loc="upper right", frameon=False)
    figure.savefig(output / "ducekf-paper.png", dpi=80)


def energy(scan: dhvpo.Scan) -> float:
    """V = eᵀPe after the scan."""
    e = np.subtract(scan.x, scan.x_hat)
    return float(e @ np.array(scan.P).reshape(2, 2) @ e)


@dataclass(frozen=True)
class Slide:
    """Arrays[scans]: true position and velocity, contact, and the measurement."""

    x: np.ndarray
    v: np.ndarray
    contact: np.ndarray
    z: np.ndarray


def slide(scans: int, seed: int, x: float = 100.0, v: float = -100.0, wobble: float = 0.0) -> Slide:
    """Between stops at 0 and 200 mm; the velocity changes by `wobble` mm/s (standard deviation) in each scan."""
    rng, rows = np.random.default_rng(seed), []
    for _ in range(scans):
        v += wobble * rng.normal()
        x, touched = x + v * DT, False
        for limit, beyond in ((0.0, x < 0.0), (UPPER, x > UPPER)):
            if beyond:
                x, v, touched = limit - KAPPA * (x - limit), -KAPPA * v, True
        rows.append((x, v, touched, x + SIGMA * rng.normal()))
    return Slide(*np.array(rows).T)


def follow(way: Slide, model: EndStops, tuning: DucekfTuning, *, tagged: bool = True) -> list[DucekfState]:
    state, states = DucekfState(), []
    for z, contact in zip(way.z, way.contact, strict=True):
        state, _ = ducekf(model, tuning, state, DucekfInputs(True, z, DT, contact if tagged else math.nan))
        states.append(state)
    return states


def draw_stops(output: Path) -> None:
    """Velocity of a slide at its stops, and how consistent each impact covariance leaves the filter."""
    way, stops = slide(400, 2), EndStops(KAPPA, 0.0, UPPER)
    aware, position = follow(way, stops, SLIDE), follow(way, stops, replace(SLIDE, contact_from="position"))
    blind = follow(way, EndStops(KAPPA, -1e9), SLIDE, tagged=False)
    for name, states in (("contact tag", aware), ("position", position), ("no constraint", blind)):
        error = np.array([state.y_dot for state in states]) - way.v
        late = np.flatnonzero(way.contact)[0] + 1
        print(f"{name}: velocity RMSE from the first impact on {math.sqrt(np.mean(error[late - 1 :] ** 2)):.1f} mm/s")

    figure, (velocity, nees) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    t = DT * np.arange(len(way.x))
    velocity.plot(t, way.v, color=TRUE, lw=1.0, label="true")
    velocity.plot(t, [state.y_dot for state in blind], color=OTHER, lw=1.2, label="same filter without constraint")
    velocity.plot(t, [state.y_dot for state in aware], color=OURS, lw=1.2, label="ducekf")
    velocity.set(xlabel="s", ylabel="mm/s", title="A slide between two stops, κ = 0.6", ylim=(-150, 110))
    velocity.legend(loc="lower right", frameon=False)

    kappas = (0.5, 0.75, 1.0, 1.25, 1.5)
    for covariance, colour in zip(COVARIANCES, (OURS, GREY, OTHER), strict=True):
        values = [mean_nees(kappa, covariance) for kappa in kappas]
        print(f"{NAMES[covariance]}: NEES", dict(zip(kappas, np.round(values, 2).tolist(), strict=True)))
        nees.plot(kappas, values, "o-", color=colour, label=NAMES[covariance])
    nees.axhline(2.0, color=TRUE, lw=0.8, ls=":")
    nees.set(
        xlabel="κ",
        ylabel="mean NEES of 20 scans after an impact",
        title="Oscillator with noise: ideal is 2",
        ylim=(0, 4),
    )
    nees.legend(loc="upper left", frameon=False)
    figure.savefig(output / "ducekf-stops.png", dpi=80)


def mean_nees(kappa: float, covariance: ImpactCovariance, runs: int = 200) -> float:
    """eᵀP⁻¹e of the noisy oscillator over the 20 scans from its first impact, Q = 1e-5·I and R = 1e-4 being true."""
    tuning = replace(dhvpo.TABLE_1, q_x=1e-5, q_x_dot=1e-5, covariance=covariance)
    values: list[float] = []
    for seed in range(runs):
        rng, size = np.random.default_rng(seed), np.sqrt([1e-5, 1e-5, 1e-4])
        scans = dhvpo.run(
            345, dhvpo.Dhvpo(kappa=kappa), tuning, noise=lambda r=rng, s=size: tuple(r.normal(size=3) * s)
        )
        hits = [scan.k for scan in scans if scan.result == Result.IMPACT]
        for scan in scans[hits[0] - 1 : hits[0] + 19] if hits else ():
            e = np.subtract(scan.x, scan.x_hat)
            values.append(float(e @ np.linalg.solve(np.array(scan.P).reshape(2, 2), e)))
    return float(np.mean(values))


def detector(sigma: float, hysteresis: float, runs: int = 500) -> tuple[float, float]:
    """Share of the oscillator's impact at k = 315 that its noisy position misses, and false impacts in 350 scans."""
    true = dhvpo.run(350)
    tuning = replace(dhvpo.TABLE_1, contact_from="position", hysteresis=hysteresis)
    missed = false = 0
    for seed in range(runs):
        rng, hits = np.random.default_rng(seed), []
        state = dhvpo.ducekf_start(0.0, 1.8, (0.2, 0.0, 0.0, 0.2), 0.0)
        for scan in true:
            z = scan.x[0] + sigma * rng.normal()
            state, result = ducekf(dhvpo.Dhvpo(), tuning, state, DucekfInputs(True, z, 0.01))
            if result == Result.IMPACT:
                hits.append(scan.k)
        near = [k for k in hits if abs(k - 315) <= 3]
        missed, false = missed + (not near), false + len(hits) - len(near)
    return missed / runs, false / runs


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/img"))
    output = parser.parse_args(arguments).output
    output.mkdir(parents=True, exist_ok=True)
    draw_paper(output)
    draw_stops(output)
    for hysteresis in (0.0, 0.04):
        missed, false = detector(0.01, hysteresis)
        print(
            f"position mode, σ = 0.01, hysteresis {hysteresis}: {missed:.1%} missed, {false:.3f} false per 350 scans"
        )


if __name__ == "__main__":
    main()
