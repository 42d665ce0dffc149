"""Draws docs/img/adaptive.png: one stretch of ramp–hold, the best AOI and the adaptive observer on the same noise.

PYTHONPATH=. python docs/scripts/adaptive.py [--output docs/img/adaptive.png]
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np

from bench import adaptive as bench
from softplc.kernel.batch import adaptive

mpl.use("agg")
from matplotlib import pyplot as plt

SEED, FROM, TO = 1, 130, 480  # scans: the end of a ramp, a hold, a ramp, the start of a hold


def probabilities(z: bench.Array, track: bench.Track) -> bench.Array:
    """Hold, cruise and manoeuvre of each scan, [3, scans]."""
    state, every = adaptive.AdaptiveBatchState(1), np.full(1, True)
    tuning = adaptive.AdaptiveTuning(
        r_x=[bench.VARIANCE], top_speed=[track.speed], top_acceleration=[track.acceleration], gate=[4.0]
    )
    out = np.empty((3, len(z)))
    for k, sample in enumerate(z):
        adaptive.step(state, tuning, EnableIn=every, x=sample, dt=np.full(1, bench.PERIOD), rows=every)
        out[:, k] = state.hold[0], state.cruise[0], state.manoeuvre[0]
    return out


def draw(output: Path) -> None:
    """Velocity above, probabilities below."""
    track = bench.CHANGING[0]
    truth = track.truth()
    z = bench.measured(truth[0], bench.uniform, [SEED])
    q_x, q_x_dot = bench.tune_fixed(bench.measured(truth[0], bench.uniform, [0])[:, 0], truth)
    fixed = bench.run_aoi(z, np.array(q_x), np.array(q_x_dot))[1, :, 0]
    ours = bench.run_adaptive(z, track.speed, track.acceleration)[1, :, 0]
    shown = slice(FROM, TO)
    t = np.arange(bench.SCANS)[shown] * bench.PERIOD

    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5), height_ratios=(2, 1))
    above.plot(t, fixed[shown], color="0.65", lw=1, label="AOI, best fixed tuning")
    above.plot(t, ours[shown], color="tab:orange", lw=1.3, label="adaptive")
    above.plot(t, truth[1][shown], color="black", lw=0.8, ls="--", label="true")
    above.set_ylabel("velocity, u/s")
    above.legend(loc="upper right", fontsize=8)
    for name, values in zip(("hold", "cruise", "manoeuvre"), probabilities(z, track), strict=True):
        below.plot(t, values[shown], lw=1, label=name)
    below.set_ylabel("probability")
    below.set_xlabel("s")
    below.legend(loc="center right", fontsize=8)
    figure.tight_layout()
    figure.savefig(output, dpi=74)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("docs/img/adaptive.png"))
    draw(parser.parse_args().output)
