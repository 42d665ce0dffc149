"""How often the lamp is right: the AOI with a known mistuning on three kinds of track, 400 seeded runs each.

`PYTHONPATH=. python docs/scripts/consistency.py` prints the tables of docs/observers/consistency.md: that one, and
one for the function block FB_KalmanFilter, whose gains as written do not come from its Q and R.
"""

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch import aoi, fb_kalman
from softplc.kernel.batch.consistency import ConsistencyState, Figures, diagnose, step
from softplc.kernel.diagnosis import Diagnosis

RUNS, SCANS, DT = 400, 330, 0.05
TUNINGS = {"firm": (0.001, 1.0, 0.1), "middle": (0.01, 0.1, 4 / 3), "soft": (0.001, 0.01, 4 / 3)}
WRONG = {
    "right": (1.0, 1.0, Diagnosis.CONSISTENT),
    "R/4": (0.25, 1.0, Diagnosis.R_TOO_SMALL),
    "4·R": (4.0, 1.0, Diagnosis.R_TOO_LARGE),
    "Q/100": (1.0, 0.01, Diagnosis.Q_TOO_SMALL),
    "100·Q": (1.0, 100.0, Diagnosis.Q_TOO_LARGE),
}
SHORT = {
    Diagnosis.CONSISTENT: "consistent",
    Diagnosis.R_TOO_SMALL: "R small",
    Diagnosis.R_TOO_LARGE: "R large",
    Diagnosis.Q_TOO_SMALL: "Q small",
    Diagnosis.Q_TOO_LARGE: "Q large",
    Diagnosis.NOT_RANDOM: "not random",
}
VARIANTS: tuple[fb_kalman.Variant, ...] = ("as_written", "corrected")
SEEN = {"each sample once": 1, "each sample twice": 2}  # a task as fast as the PLC, and one twice as fast


def track(kind: str, q_x: float, q_x_dot: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """True positions [scans, runs]."""
    t = np.arange(SCANS)[:, np.newaxis] * DT
    if kind == "as the model":
        v = rng.normal(0, 5, RUNS) + np.cumsum(rng.normal(0, math.sqrt(q_x_dot), (SCANS, RUNS)), axis=0)
        return np.cumsum(v * DT + rng.normal(0, math.sqrt(q_x), (SCANS, RUNS)), axis=0)
    if kind == "ramp and hold":
        at = (t + rng.uniform(0, 60, RUNS)) % 60
        return np.select([at < 15, at < 30, at < 45], [10 * at, 150, 150 - 10 * (at - 30)], 0.0)
    period = 20 if kind == "slow sine" else 8
    return 20 * np.sin(2 * np.pi * t / period + rng.uniform(0, 2 * np.pi, RUNS))


def verdicts(kind: str, tuning: tuple[float, float, float], r: float, q: float) -> Counter[Diagnosis]:
    """The lamp at the end of each run."""
    rng = np.random.default_rng(1)
    q_x, q_x_dot, r_x = tuning
    z = track(kind, q_x, q_x_dot, rng) + rng.normal(0, math.sqrt(r_x), (SCANS, RUNS))
    one, everyone = np.ones(RUNS), np.ones(RUNS, np.bool_)
    state = aoi.AoiBatchState(RUNS)
    used = aoi.AoiTuning(
        np.float64,
        q_x=one * q_x * q,
        q_x_dot=one * q_x_dot * q,
        r_x=one * r_x * r,
        BleedEnable=~everyone,
        BleedThresh=one,
        BleedFactor=one,
    )
    window = ConsistencyState(RUNS, 200, 5)
    for row in z:
        aoi.step(state, used, EnableIn=everyone, x=row, dt=one * DT * 1000.0, rows=everyone)
        step(window, state.y_res, state.S, everyone)
    return Counter(Diagnosis(code) for code in diagnose(window, Figures(window), state.K0))


def block_verdicts(kind: str, variant: fb_kalman.Variant, times: int) -> Counter[Diagnosis]:
    """The lamp of the function block with Q = 0.1 and R = 1, which is the noise; each sample is given `times`."""
    rng = np.random.default_rng(1)
    samples = track(kind, 0.0, 0.1, rng) + rng.normal(0, 1, (SCANS, RUNS))
    one, everyone = np.ones(RUNS), np.ones(RUNS, np.bool_)
    state = fb_kalman.FbKalmanBatchState(RUNS)
    start: fb_kalman.Start = "zero" if variant == "as_written" else "measurement"
    tuning = fb_kalman.FbKalmanTuning(np.float64, Q=0.1 * one, R=one, variant=variant, start=start)
    window = ConsistencyState(RUNS, 200, 5)
    for row in np.repeat(samples, times, axis=0)[-SCANS:]:
        fb_kalman.step(state, tuning, EnableIn=everyone, x=row, dt=one * DT / times, rows=everyone)
        step(window, state.y_res, state.S, everyone)
    return Counter(Diagnosis(code) for code in diagnose(window, Figures(window), state.KalmanGain))


def text_of(found: Counter[Diagnosis], expected: Diagnosis) -> str:
    """A cell: how often it is what it should be, and what it is otherwise in more than a tenth of the runs."""
    others = [code for code, _ in found.most_common() if code != expected and found[code] > RUNS // 10]
    right = f"{100 * found[expected] / RUNS:.0f} %"
    return right + "".join(f", {SHORT[code]} {100 * found[code] / RUNS:.0f}" for code in others)


def main() -> None:
    """Print the tables."""
    print("| track | tuning | " + " | ".join(WRONG) + " |")
    print("|---" * (2 + len(WRONG)) + "|")
    for kind in ("as the model", "ramp and hold", "sine"):
        for name, tuning in TUNINGS.items():
            cells = [text_of(verdicts(kind, tuning, r, q), expected) for r, q, expected in WRONG.values()]
            print(f"| {kind} | {name} | " + " | ".join(cells) + " |")

    print("\n| track | the task reads | as written | corrected |")
    print("|---|---|---|---|")
    for kind in ("as the model", "ramp and hold", "slow sine"):
        for seen, times in SEEN.items():
            found = [block_verdicts(kind, variant, times) for variant in VARIANTS]
            print(f"| {kind} | {seen} | " + " | ".join(text_of(one, Diagnosis.CONSISTENT) for one in found) + " |")


if __name__ == "__main__":
    main()
