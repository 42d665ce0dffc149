"""The investigation's method table as a section of the AOI study."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from softplc.commissioning.figures import ESTIMATE, MEASURED, SECOND, THIRD, TRUTH, WRONG, new, png
from softplc.commissioning.report import Claim, Picture, Section, Table
from softplc.commissioning.study.method_numbers import SCORED, MethodNumbers
from softplc.commissioning.study.waveform import Waveform

_COLOURS = {
    "moving average": SECOND,
    "numerical differentiation": MEASURED,
    "IEC 61131-3 DERIVATIVE": "#8d6e63",
    "α-β, tracking index": THIRD,
    "1€ filter": "#8e44ad",
    "2-state Kalman, the AOI": ESTIMATE,
    "3-state Kalman, cv_accel": WRONG,
}
_SHOWN = ("numerical differentiation", "moving average", "α-β, tracking index", "2-state Kalman, the AOI")


def section(methods: Sequence[MethodNumbers], wave: Waveform) -> Section:
    """Table and pictures. The investigation gives words for its first four methods, these are the numbers."""
    return Section(
        "The investigation's methods, and others, on this waveform",
        [
            "Each method with the setting that has the least product of both errors on the noise that is shown, "
            f"scored on the {SCORED} next realisations. Once settled the AOI is an α-β filter too; what it has ahead "
            "of it is its start, with gains that begin high and come down.",
            _table(methods),
            _at_the_stop(methods, wave),
            _all_settings(methods),
        ],
    )


def to_json(methods: Sequence[MethodNumbers]) -> list[dict[str, Any]]:
    """One entry for each method."""
    return [
        {"method": one.method.name, "setting": dict(zip(one.method.names, one.setting, strict=True))}
        | asdict(one.score)
        for one in methods
    ]


def claim(methods: Sequence[MethodNumbers]) -> Claim:
    """The investigation's decision."""
    judged = {one.method.name: one for one in methods if one.method.verdict}
    kalman = judged.pop("2-state Kalman, the AOI").score
    others = [one.score for one in judged.values()]
    return Claim(
        "of the investigation's four methods the 2-state Kalman filter is the best balance",
        "least RMSE of position and of velocity",
        f"{kalman.rmse_position:.3f} u, {kalman.rmse_velocity:.2f} u/s; next best "
        f"{min(one.rmse_position for one in others):.3f} u, {min(one.rmse_velocity for one in others):.2f} u/s (α-β)",
        all(kalman.rmse_position < one.rmse_position and kalman.rmse_velocity < one.rmse_velocity for one in others),
    )


def _table(methods: Sequence[MethodNumbers]) -> Table:
    rows = [
        (
            one.method.name,
            one.method.verdict or "–",
            one.method.label(one.setting),
            f"{one.score.rmse_position:.3f}",
            f"{one.score.rmse_velocity:.2f}",
            f"{one.score.lag * 1000.0:.0f}",
            f"{one.score.stop * 1000.0:.0f}",
            f"{one.score.noise_position:.2f}",
            f"{one.score.noise_velocity:.2f}",
            f"{one.score.overshoot:.2f}",
        )
        for one in methods
    ]
    columns = (
        "method",
        "investigation",
        "setting",
        "RMSE, u",
        "RMSE, u/s",
        "lag, ms",
        "stop, ms",
        "noise, u",
        "noise, u/s",
        "overshoot, u",
    )
    return Table(
        columns,
        rows,
        "RMSE of position and velocity over all scans. Lag: how late the position is on a ramp. Stop: until the "
        "velocity has fallen below a tenth, without noise. Noise: standard deviation at rest; the measured "
        "position has 1.15 u. Overshoot: the farthest beyond where the axis stopped, noise included.",
        words=3,
    )


def _at_the_stop(methods: Sequence[MethodNumbers], wave: Waveform) -> Picture:
    figure = new(9.0, 3.8)
    left, right = figure.subplots(1, 2)
    for one in methods:
        if one.method.name in _SHOWN:
            style = {"color": _COLOURS[one.method.name], "label": one.method.name}
            left.plot(wave.t, one.position, **style)
            right.plot(wave.t, one.velocity, **style)
    for axes, truth, name in ((left, wave.position, "position, u"), (right, wave.velocity, "velocity, u/s")):
        axes.plot(wave.t, truth, color=TRUTH, linewidth=0.9, linestyle=(0, (4, 3)), label="truth")
        axes.set(xlabel="time, s", ylabel=name, xlim=(13.0, 18.0))
    left.set_ylim(130.0, 154.0)
    right.set_ylim(-15.0, 25.0)
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return Picture(
        "aoi-methods-stop",
        png(figure),
        "Position and velocity of four methods around the first stop.",
        "The investigation's four methods at the first stop. The moving average is late by its lag on the ramp; "
        "differentiation has the position's noise and a velocity that is hidden in it.",
    )


def _all_settings(methods: Sequence[MethodNumbers]) -> Picture:
    figure = new(9.0, 4.6)
    axes = figure.subplots()
    for one in methods:
        name, colour = one.method.name, _COLOURS[one.method.name]
        position, velocity = one.swept
        if len(position) == 1:
            axes.plot(position, velocity, "*", color=colour, markersize=11, label=name)
        else:
            several = len(one.method.names) > 2
            axes.plot(
                position, velocity, "." if several else ".-", color=colour, markersize=5, linewidth=1.0, label=name
            )
            at = one.method.settings.index(one.setting)
            axes.plot(position[at], velocity[at], "o", color=colour, fillstyle="none", markersize=10)
    axes.set(
        xscale="log", yscale="log", xlabel="RMSE of position, u", ylabel="RMSE of velocity, u/s", xlim=(0.4, 4.0)
    )
    axes.set_xticks([0.5, 1.0, 2.0, 4.0], ["0.5", "1", "2", "4"])
    axes.set_yticks([1.0, 2.0, 5.0, 10.0, 20.0], ["1", "2", "5", "10", "20"])
    axes.set_ylim(1.2, 45.0)
    axes.minorticks_off()
    axes.legend(loc="upper right", ncols=2)
    return Picture(
        "aoi-methods",
        png(figure),
        "Velocity error against position error for every setting of every method.",
        "Every setting that was weighed, on the noise shown: nearer to the lower left is better. Circles are the "
        "settings of the table. No choice of window, cutoff or gain brings the simpler methods to where the "
        "Kalman filter and the α-β filter are.",
    )
