"""The pictures of the AOI study."""

from typing import Any

import numpy as np

from softplc.commissioning.figures import BAND, ESTIMATE, MEASURED, SECOND, THIRD, TRUTH, WRONG, legend, new, png
from softplc.commissioning.report import Picture, number
from softplc.commissioning.study.aoi_numbers import BLEED_FACTOR, BLEED_THRESHOLDS, AoiNumbers
from softplc.commissioning.study.aoi_runs import noise_left
from softplc.commissioning.study.waveform import DT, NOISE, SCANS, SLOPE, R

_SEGMENT = SCANS * DT  # s


def trend(numbers: AoiNumbers) -> Picture:
    """Figure 2 of the paper, and two looks through the magnifying glass."""
    wave, span = numbers.wave, (0.0, 4 * _SEGMENT)
    figure = new(9.0, 8.4)
    grid = figure.add_gridspec(3, 2, height_ratios=(1.25, 1.0, 1.1))
    top, errors = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
    _positions(top, numbers)
    top.set(xlabel="time, s", ylabel="position, u", title="ramp – hold – ramp – hold", xlim=span)
    legend(top)
    errors.plot(wave.t, wave.measured - wave.position, color=MEASURED, linewidth=0.7, label="measured − truth")
    errors.plot(wave.t, numbers.trace.position - wave.position, color=ESTIMATE, label="estimate − truth")
    errors.set(xlabel="time, s", ylabel="error, u", title="the same, truth taken away", xlim=span)
    legend(errors)
    for axes, (start, stop), title in (
        (figure.add_subplot(grid[2, 0]), (7.0, 9.5), "on the ramp: no lag"),
        (figure.add_subplot(grid[2, 1]), (14.0, 19.0), "at the stop: overshoot, then quiet"),
    ):
        _positions(axes, numbers)
        shown = (wave.t >= start) & (wave.t <= stop)
        low, high = wave.measured[shown].min(), wave.measured[shown].max()
        axes.set(xlabel="time, s", xlim=(start, stop), ylim=(low - 0.5, high + 1.0), title=title)
    left, right = numbers.overshoots
    return Picture(
        "aoi-figure-2",
        png(figure),
        "Noisy position in grey, Kalman estimate in orange and the truth as a dashed line, over four segments.",
        "The paper's Figure 2: what was measured (grey, U(−2, 2) on the truth at 50 ms) and what the AOI makes of it "
        f"(orange); the truth is dashed. At the two stops the estimate overshoots by {left:.2f} and {right:.2f} u.",
    )


def _positions(axes: Any, numbers: AoiNumbers) -> None:
    wave = numbers.wave
    axes.plot(wave.t, wave.measured, color=MEASURED, linewidth=0.9, label="measured")
    axes.plot(wave.t, numbers.trace.position, color=ESTIMATE, linewidth=1.6, label="estimate")
    axes.plot(wave.t, wave.position, color=TRUTH, linewidth=0.9, linestyle=(0, (4, 3)), label="truth")


def velocity(numbers: AoiNumbers) -> Picture:
    """Velocity estimate with the band that the settled gains predict."""
    _, spread = noise_left(*numbers.steady, DT)
    sigma = spread * np.sqrt(R)
    wave, trace = numbers.wave, numbers.trace
    figure = new(9.0, 3.5)
    axes = figure.subplots()
    axes.fill_between(
        wave.t,
        wave.velocity - 2 * sigma,
        wave.velocity + 2 * sigma,
        color=SECOND,
        alpha=0.15,
        linewidth=0,
        label="±2σ",
    )
    axes.plot(wave.t, trace.velocity, color=ESTIMATE, label="estimate")
    axes.plot(wave.t, wave.velocity, color=TRUTH, linewidth=0.9, linestyle=(0, (4, 3)), label="truth")
    axes.set(xlabel="time, s", ylabel="velocity, u/s", xlim=(0.0, 4 * _SEGMENT), title="velocity, never measured")
    legend(axes)
    first = numbers.segments[0]
    return Picture(
        "aoi-velocity",
        png(figure),
        "Estimated velocity in orange around the true velocity, which is 10 or 0.",
        "The velocity that position alone reveals. First ramp, once settled: mean error "
        f"{first.velocity_error_mean:.3f} u/s, standard deviation {first.velocity_error_std:.2f} u/s. The band is "
        f"±2 of the {sigma:.2f} u/s that the settled gains predict for this noise.",
    )


def gains(numbers: AoiNumbers) -> Picture:
    """K0 and K1 from the first scan until they have settled."""
    figure = new(9.0, 3.2)
    scans = np.arange(1, 81)
    for axes, values, goal, settled, name in zip(
        figure.subplots(1, 2),
        (numbers.trace.K0, numbers.trace.K1),
        numbers.steady,
        numbers.settled_scans,
        ("K0", "K1, 1/s"),
        strict=True,
    ):
        axes.axhline(goal, color=TRUTH, linewidth=0.9, linestyle=(0, (4, 3)), label=f"closed form {goal:.4f}")
        axes.plot(scans, values[: len(scans)], color=ESTIMATE, marker=".", markersize=4, label="AOI")
        axes.axvspan(settled, len(scans), color=BAND, zorder=0)
        axes.set(xlabel="scan", ylabel=name, xlim=(0, len(scans)), ylim=(0, None))
        axes.legend(loc="upper right")
    return Picture(
        "aoi-gains",
        png(figure),
        "Both gains over the first 80 scans, approaching a dashed line each.",
        "Gains after the start, and where the closed form says that they settle. Shaded: within 1 % for good, "
        f"from scan {numbers.settled_scans[0]} (K0) and {numbers.settled_scans[1]} (K1) on. From then on the "
        "observer is an α-β filter.",
    )


def bleed(numbers: AoiNumbers) -> Picture:
    """Bleed off and on: the gain at the stop, the price on the ramp."""
    wave = numbers.wave
    figure = new(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        axes.plot(wave.t, numbers.trace.velocity, color=ESTIMATE, label="bleed off")
        axes.plot(wave.t, numbers.bled.velocity, color=SECOND, label="bleed on")
        axes.plot(wave.t, wave.velocity, color=TRUTH, linewidth=0.9, linestyle=(0, (4, 3)), label="truth")
        axes.set(xlabel="time, s")
    left.set(xlim=(5.0, 12.0), ylim=(4.0, 13.0), ylabel="velocity, u/s", title="on a true ramp")
    right.set(xlim=(13.5, 20.0), ylim=(-4.0, 13.0), title="at the stop")
    right.legend(loc="upper right")
    off, on = numbers.bleed[:2]
    return Picture(
        "aoi-bleed",
        png(figure),
        "Velocity with and without bleed, on a ramp and at a stop.",
        f"Bleed at threshold {BLEED_THRESHOLDS[0]:g} u, factor {BLEED_FACTOR:g}. It shortens the overshoot of the "
        f"position from {off.overshoot:.2f} to {on.overshoot:.2f} u. It tests how far the measurement is from the "
        f"estimate, which is little on every well-tracked ramp too: there a true {SLOPE:g} u/s reads "
        f"{on.velocity_on_ramp:.1f}.",
    )


def scan_rate(numbers: AoiNumbers) -> Picture:
    """Bandwidth and slowest time constant over the time step."""
    figure = new(9.0, 3.4)
    left, right = figure.subplots(1, 2)
    dt = [row.dt * 1000.0 for row in numbers.rates]
    for axes, per_scan, scaled, name in (
        (
            left,
            [row.bandwidth for row in numbers.rates],
            [row.scaled_bandwidth for row in numbers.rates],
            "bandwidth K0/Δt, 1/s",
        ),
        (
            right,
            [row.time_constant for row in numbers.rates],
            [row.scaled_time_constant for row in numbers.rates],
            "slowest time constant, s",
        ),
    ):
        axes.loglog(dt, per_scan, color=ESTIMATE, marker="o", markersize=4, label="Q per scan, as written")
        axes.loglog(dt, scaled, color=THIRD, marker="s", markersize=4, label="q ∝ Δt, r ∝ 1/Δt")
        axes.set_xticks(dt, [f"{step:g}" for step in dt])
        axes.minorticks_off()
        axes.set(xlabel="Δt, ms", ylabel=name)
    left.set_yticks([2, 5, 10, 20], ["2", "5", "10", "20"])
    right.set_yticks([0.1, 0.2, 0.5, 1.0], ["0.1", "0.2", "0.5", "1"])
    right.set_ylim(0.08, 1.1)
    left.legend(loc="upper right")
    return Picture(
        "aoi-scan-rate",
        png(figure),
        "Bandwidth and time constant against the time step, falling and rising for noise per scan, flat when scaled.",
        "The same tuning at other scan rates. The paper calls the dependence mild; between 2 and 100 ms the "
        f"bandwidth changes by a factor of {numbers.rates[0].bandwidth / numbers.rates[-1].bandwidth:.0f}.",
    )


def precision(numbers: AoiNumbers) -> Picture:
    """What single precision costs."""
    wave = numbers.wave
    figure = new(9.0, 2.8)
    axes = figure.subplots()
    axes.plot(
        wave.t, numbers.single.velocity - numbers.trace.velocity, color=SECOND, linewidth=0.8, label="velocity, u/s"
    )
    axes.plot(
        wave.t, numbers.single.position - numbers.trace.position, color=WRONG, linewidth=0.8, label="position, u"
    )
    axes.set(xlabel="time, s", xlim=(0.0, 4 * _SEGMENT), title="REAL − LREAL")
    legend(axes)
    position, speed = numbers.single_difference()
    return Picture(
        "aoi-precision",
        png(figure),
        "Difference of the single and the double precision estimates: noise of a few hundred-thousandths.",
        "The AOI in REAL (every operation rounded to single precision, as a Logix controller does) against LREAL: "
        f"at most {number(position, 2)} u and {number(speed, 2)} u/s, beside noise of ±{NOISE:g} u.",
    )
