"""The pictures of the DUCEKF study: Figures 1 to 3 of the paper, the hold, the impact's covariance, the timing."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from softplc.commissioning.figures import (
    BAND,
    ESTIMATE,
    MEASURED,
    SECOND,
    THIRD,
    TRUTH,
    WRONG,
    legend,
    new,
    png,
)
from softplc.commissioning.report import Picture
from softplc.commissioning.study.ducekf_noise import COVARIANCES, KAPPAS
from softplc.commissioning.study.ducekf_numbers import KAPPA_EKF, DucekfNumbers
from softplc.commissioning.study.ducekf_timing import ITERATIONS
from softplc.kernel.reference.covariance import impact_covariance
from softplc.kernel.reference.dhvpo import TABLE_1, Scan

_DT = 0.01  # s
NAMES = {"omega": "Ω∘P, the paper", "none": "P unchanged, the EKF", "saltation": "ÃPÃᵀ, saltation"}
_COLOURS = {"omega": ESTIMATE, "none": MEASURED, "saltation": SECOND}


def states(scans: Sequence[Scan]) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Rows of x(1), x(2), x̂(1), x̂(2), one column for each iteration."""
    return np.array([(*scan.x, *scan.x_hat) for scan in scans]).T


def time_series(numbers: DucekfNumbers) -> Picture:
    """Figure 1."""
    shown = numbers.scans[:1050]
    t = np.arange(1, len(shown) + 1) * _DT
    rows = states(shown)
    figure = new(9.0, 5.4)
    grid = figure.add_gridspec(2, 3)
    for row, name in enumerate(("x(1)", "x(2)")):
        wide, near = figure.add_subplot(grid[row, :2]), figure.add_subplot(grid[row, 2])
        wide.plot(t, rows[row], color=TRUTH, linewidth=1.8, label="DHVPO")
        wide.plot(t, rows[row + 2], color=ESTIMATE, linestyle=(0, (5, 2)), label="DUCEKF")
        for k in numbers.impacts:
            if k <= len(shown):
                wide.axvline(k * _DT, color=BAND, linewidth=5, zorder=0)
        near.plot(t, rows[row] - rows[row + 2], color=WRONG)
        near.axhline(0.0, color=TRUTH, linewidth=0.8)
        wide.set(xlim=(0.0, t[-1]), ylabel=f"{('position', 'velocity')[row]} {name}")
        near.set(xlim=(0.0, 2.0), title=f"{name} − x̂{name[1:]}, the first 2 s")
        if row == 0:
            wide.set_title("impacts shaded")
            legend(wide)
    for axes in figure.axes[2:]:
        axes.set_xlabel("time, s")
    return Picture(
        "ducekf-figure-1",
        png(figure),
        "Position and velocity of oscillator and estimate over ten seconds with three impacts; they coincide from "
        "1 s on.",
        "The paper's Figure 1. The estimate starts with a velocity of 1.8 instead of 1.5; from k = "
        f"{numbers.converged} on it is within 0.015 of the oscillator's, through every impact.",
    )


def phase_portrait(numbers: DucekfNumbers) -> Picture:
    """Figure 2."""
    rows = states(numbers.scans[:1050])
    figure = new(9.0, 5.2)
    axes = figure.subplots()
    axes.axvspan(0.0, TABLE_1.band, color=SECOND, alpha=0.2, linewidth=0, label="activation set (0, ε₀]")
    axes.plot(rows[0], rows[1], color=TRUTH, linewidth=2.0, label="DHVPO")
    axes.plot(rows[2], rows[3], color=ESTIMATE, linestyle=(0, (5, 2)), label="DUCEKF")
    axes.plot([0.0], [1.5], "o", color=TRUTH, markersize=5)
    axes.plot([0.0], [1.8], "o", color=ESTIMATE, markersize=5)
    axes.annotate("x₀ = (0, 1.5)", (0.0, 1.5), (8, -16), textcoords="offset points", color=TRUTH)
    axes.annotate("x̂₀ = (0, 1.8)", (0.0, 1.8), (8, 2), textcoords="offset points", color=ESTIMATE)
    before, after = numbers.scans[numbers.impacts[0] - 2].x, numbers.scans[numbers.impacts[0] - 1].x
    axes.annotate(
        "",
        (after[0], after[1]),
        (before[0], before[1]),
        arrowprops={"arrowstyle": "->", "color": WRONG, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0},
    )
    axes.annotate(
        f"impact, k = {numbers.impacts[0]}\nx(2) → −κx(2)",
        (0.0, -0.4),
        (12, 0),
        textcoords="offset points",
        color=WRONG,
    )
    axes.set(xlabel="x(1)", ylabel="x(2)", xlim=(-0.08, None))
    axes.legend(loc="lower right")
    return Picture(
        "ducekf-figure-2",
        png(figure),
        "Phase portrait: both trajectories run on the same loop, which jumps from negative to positive velocity "
        "at x = 0.",
        "The paper's Figure 2. At the impact surface the position stays and the velocity turns, from "
        f"{before[1]:.3f} to {after[1]:.3f}.".replace("-", "−"),
    )


def lyapunov(numbers: DucekfNumbers) -> Picture:
    """Figure 3, on two scales."""
    figure = new(9.0, 3.5)
    left, right = figure.subplots(1, 2)
    found = numbers.lyapunov
    k = [impact.k for impact in found]
    left.vlines(k, 0.0, [one.ekf / one.ekf_before for one in found], color=WRONG, linewidth=1.4)
    left.plot(
        k, [one.ekf / one.ekf_before for one in found], "o", color=WRONG, markersize=6, label="EKF, P unchanged"
    )
    left.plot(
        k, [one.ducekf / one.ducekf_before for one in found], "D", color=THIRD, markersize=6, label="DUCEKF, Ω∘P"
    )
    left.axhline(0.0, color=TRUTH, linewidth=0.9)
    left.set(ylabel="ΔV / V", ylim=(-0.2, 1.6), title="relative")
    legend(left)
    right.semilogy(k, [one.ekf for one in found], "o", color=WRONG, markersize=6, label="EKF, all positive")
    right.semilogy(
        k, [abs(one.ducekf) for one in found], "D", color=THIRD, fillstyle="none", label="DUCEKF: last bits of V"
    )
    right.set(ylabel="|ΔV|", ylim=(1e-33, 1e-8), title="absolute")
    right.legend(loc="upper right")
    for axes in (left, right):
        axes.set(xlabel="k", xlim=(0, 1050))
        axes.set_xticks([0, *k])
    return Picture(
        "ducekf-figure-3",
        png(figure),
        "Change of the Lyapunov function at three impacts: positive for the EKF, zero for the DUCEKF.",
        f"The paper's Figure 3, κ = {KAPPA_EKF}: how V = eᵀPe changes at each impact. With P left alone it grows "
        f"by {growth_percent(numbers):.0f} % each time; with Ω it stays. The error has long converged, so in "
        "absolute terms (right) the numbers are tiny, and what is left of the DUCEKF's is rounding.",
    )


def growth_percent(numbers: DucekfNumbers) -> float:
    """By how many per cent V grows at the first impact when P stays."""
    first = numbers.lyapunov[0]
    return 100.0 * first.ekf / first.ekf_before


def hold(numbers: DucekfNumbers) -> Picture:
    """The rule of section 3: an estimate that is early waits."""
    start, stop = 270, 340
    shown = numbers.hold[start - 1 : stop]
    k = np.arange(start, stop + 1)
    rows = states(shown)
    figure = new(9.0, 3.4)
    for axes, real, estimate, name in zip(
        figure.subplots(1, 2), (0, 1), (2, 3), ("position x(1)", "velocity x(2)"), strict=True
    ):
        axes.axvspan(numbers.held[0] - 0.5, numbers.held[-1] + 0.5, color=BAND, zorder=0, label="hold")
        axes.plot(k, rows[real], color=TRUTH, marker=".", markersize=4, label="DHVPO")
        axes.plot(k, rows[estimate], color=ESTIMATE, marker=".", markersize=4, label="DUCEKF")
        axes.set(xlabel="k", ylabel=name, xlim=(start, stop))
    figure.axes[0].legend(loc="upper right")
    return Picture(
        "ducekf-hold",
        png(figure),
        "The estimate reaches the surface early, stays there while shaded, and turns together with the oscillator.",
        f"Route 5, which Table 1 never takes: x̂₀ = (0.3, 1.5) and R = 1000. The estimate waits at the surface from "
        f"k = {numbers.held[0]} to {numbers.held[-1]} ({len(numbers.held)} scans); at 315 both make the transition.",
    )


def covariance(numbers: DucekfNumbers) -> Picture:
    """What each rule makes of P at the impact, and what it is worth when there is noise."""
    figure = new(9.0, 3.6)
    axes = figure.subplots(1, 3, width_ratios=(1, 1, 1.25))
    before = numbers.scans[numbers.impacts[0] - 2].P
    for panel, kappa in zip(axes[:2], KAPPAS, strict=True):
        for rule in COVARIANCES:
            name = NAMES[rule]
            panel.plot(
                *_ellipse(impact_covariance(before, rule, 1.0, -kappa)),
                color=_COLOURS[rule],
                linewidth=2.0,
                label=name,
            )
        panel.set(xlabel="e(1)", ylabel="e(2)", title=f"P after the impact, κ = {kappa:g}")
        panel.xaxis.set_major_locator(_ticks(3))
    _bars(axes[2], numbers)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return Picture(
        "ducekf-covariance",
        png(figure),
        "One-sigma ellipses of the covariance after an impact for three rules, and bars of the mean normalised "
        "error.",
        "Left: one-σ ellipses at the first impact. Right: eᵀP⁻¹e over the 20 scans from the impact on, with noise "
        "that the filter knows; bars above 2 are overconfident, below 2 too cautious. Lines are two standard "
        "errors.",
    )


def _ticks(count: int) -> Any:
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    return MaxNLocator(count)


def _ellipse(P: tuple[float, float, float, float]) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Where eᵀP⁻¹e is 1."""
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    root = np.linalg.cholesky(np.array(P).reshape(2, 2))
    return np.asarray(root @ np.array([np.cos(angle), np.sin(angle)]))


def _bars(axes: Any, numbers: DucekfNumbers) -> None:
    for group, kappa in enumerate(KAPPAS):
        for place, rule in enumerate(COVARIANCES):
            one = next(row for row in numbers.noise if (row.kappa, row.covariance) == (kappa, rule))
            at = group + (place - 1) * 0.26
            axes.bar(at, one.nees, 0.24, color=_COLOURS[rule])
            axes.errorbar(at, one.nees, 2.0 * one.nees_error, color=TRUTH, linewidth=1.0, capsize=2)
    axes.axhline(2.0, color=TRUTH, linewidth=1.0, linestyle=(0, (4, 3)))
    axes.set_xticks(range(len(KAPPAS)), [f"κ = {kappa:g}" for kappa in KAPPAS])
    axes.grid(visible=False, axis="x")
    axes.set(title="eᵀP⁻¹e, ideal 2", ylim=(0.0, None))


def timing(numbers: DucekfNumbers) -> Picture:
    """How long each iteration takes here."""
    measured = numbers.timing
    k = np.arange(1, ITERATIONS + 1)
    low, high = np.percentile(measured.times, [5, 95], axis=0)
    figure = new(9.0, 3.0)
    axes = figure.subplots()
    axes.fill_between(k, low, high, color=SECOND, alpha=0.2, linewidth=0, label="5 to 95 %")
    axes.plot(k, measured.typical(), color=SECOND, linewidth=1.0, label="median")
    impact = numbers.impacts[0]
    axes.plot(
        [impact], [measured.typical()[impact - 1]], "o", color=WRONG, markersize=5, label=f"impact, k = {impact}"
    )
    axes.set(xlabel="k", ylabel="time, µs", xlim=(1, ITERATIONS), ylim=(0.0, 1.4 * float(np.median(high))))
    axes.set_title("steps 9 to 19 on this machine")
    legend(axes)
    return Picture(
        "ducekf-timing",
        png(figure),
        "Time of each of the 350 iterations with its spread over the repetitions.",
        f"Each iteration measured {len(measured.times)} times. The iteration of the transition takes "
        f"{measured.paths[2].here_us / measured.paths[1].here_us:.2f} of the time of the others; on the paper's "
        f"dsPIC it is {measured.paths[2].paper_us / measured.paths[1].paper_us:.2f}.",
    )
