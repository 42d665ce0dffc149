"""Figures 5 to 7 of the DUCEKF paper as their screens show them: an oscilloscope, and the display of the hardware."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softplc.commissioning.figures import legend, new, png
from softplc.commissioning.report import Picture
from softplc.commissioning.study.ducekf_figures import states
from softplc.commissioning.study.ducekf_timing import DAC_SPAN, dac_words
from softplc.kernel.reference.dhvpo import Scan

CYAN, YELLOW, GREEN = "#00e5ff", "#ffe600", "#16361f"
_DASHES = (0, (6, 5))  # so that both are seen where they agree
_DT = 0.01


def hmi(scans: Sequence[Scan]) -> Picture:
    """Figure 7: the phase portraits on a display of 320 × 240, numbers on top."""
    rows = states(scans)
    figure = new(8.0, 6.0)  # 4:3, as the display
    figure.set_facecolor("black")
    axes = figure.subplots()
    axes.set_facecolor("black")
    axes.grid(color="#26323a", linewidth=0.6)
    axes.plot(rows[0], rows[1], color=YELLOW, linewidth=3.2)
    axes.plot(rows[2], rows[3], color=CYAN, linewidth=1.8, linestyle=_DASHES)
    axes.plot(*rows[:2, -1:], "o", color=YELLOW, markersize=8)
    axes.plot(*rows[2:, -1:], "o", color=CYAN, markersize=5)
    axes.tick_params(colors="#8fa3ad")
    for spine in axes.spines.values():
        spine.set_color("#4a5a63")
    axes.set_xlabel("x(1)", color="#cfd8dc")
    axes.set_ylabel("x(2)", color="#cfd8dc")
    x1, x2, e1, e2 = rows[:, -1]
    for place, colour, text in (
        (0.0, YELLOW, f"real      {x1:+.4f}  {x2:+.4f}"),
        (0.5, CYAN, f"estimate  {e1:+.4f}  {e2:+.4f}"),
    ):
        axes.text(
            place,
            1.03,
            text.replace("-", "−"),
            transform=axes.transAxes,
            color=colour,
            fontsize=13,
            fontfamily="DejaVu Sans Mono",
        )
    return Picture(
        "ducekf-figure-7",
        png(figure),
        "A black display: real phase portrait in yellow, estimated one in cyan on top of it, both states as "
        "numbers above.",
        f"The paper's Figure 7, as an operator sees it at k = {scans[-1].k}: real portrait yellow, estimate cyan, "
        "the four states as numbers on top.",
    )


def oscilloscope(scans: Sequence[Scan]) -> Picture:
    """Figures 5 and 6: what comes out of the converter of 12 bits."""
    rows = states(scans)
    levels = np.array([_levels(dac_words(column)) for column in rows.T]).T
    t = np.arange(1, len(scans) + 1) * _DT
    figure = new(9.0, 4.4)
    figure.set_facecolor("#0b1210")
    for axes, real, estimate, name in zip(
        figure.subplots(2, 1, sharex=True), (0, 1), (2, 3), ("position", "velocity"), strict=True
    ):
        axes.set_facecolor("#0b1210")
        axes.grid(color=GREEN, linewidth=0.8)
        axes.plot(t, levels[real], color=YELLOW, linewidth=3.0, label="DHVPO")
        axes.plot(t, levels[estimate], color=CYAN, linewidth=1.6, linestyle=_DASHES, label="DUCEKF")
        axes.tick_params(colors="#8fa3ad")
        axes.set_ylabel(f"{name}, counts", color="#cfd8dc")
        axes.set_xlim(0.0, t[-1])
        for spine in axes.spines.values():
            spine.set_color(GREEN)
    legend(figure.axes[0], labelcolor="#cfd8dc")
    figure.axes[1].set_xlabel("time, s", color="#cfd8dc")
    return Picture(
        "ducekf-figures-5-6",
        png(figure),
        "Two traces on a dark screen, real in yellow and estimated in cyan, for position and for velocity.",
        f"The paper's Figures 5 and 6: the states in the converter's 12 bits, −{DAC_SPAN:g} … {DAC_SPAN:g} as 0 … "
        "4095, packed in words of 24 bits and unpacked again.",
    )


def _levels(words: bytes) -> NDArray[np.int64]:
    """The 12 data bits of each word."""
    return np.array([(words[at + 1] << 4) | (words[at + 2] >> 4) for at in range(0, len(words), 3)])
