"""How often the lamp is right: the AOI with a known mistuning on three kinds of track, 400 seeded runs each.

`PYTHONPATH=. python docs/scripts/consistency.py` prints the table of docs/observers/consistency.md.
"""

import math
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch import aoi
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
}


def track(kind: str, q_x: float, q_x_dot: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """True positions [scans, runs]."""
    t = np.arange(SCANS)[:, np.newaxis] * DT
    if kind == "as the model":
        v = rng.normal(0, 5, RUNS) + np.cumsum(rng.normal(0, math.sqrt(q_x_dot), (SCANS, RUNS)), axis=0)
        return np.cumsum(v * DT + rng.normal(0, math.sqrt(q_x), (SCANS, RUNS)), axis=0)
    if kind == "ramp and hold":
        at = (t + rng.uniform(0, 60, RUNS)) % 60
        return np.select([at < 15, at < 30, at < 45], [10 * at, 150, 150 - 10 * (at - 30)], 0.0)
    return 20 * np.sin(2 * np.pi * t / 8 + rng.uniform(0, 2 * np.pi, RUNS))


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


def main() -> None:
    """Print the table."""
    print("| track | tuning | " + " | ".join(WRONG) + " |")
    print("|---" * (2 + len(WRONG)) + "|")
    for kind in ("as the model", "ramp and hold", "sine"):
        for name, tuning in TUNINGS.items():
            cells = []
            for r, q, expected in WRONG.values():
                found = verdicts(kind, tuning, r, q)
                others = [code for code, _ in found.most_common() if code != expected and found[code] > RUNS // 10]
                text = f"{100 * found[expected] / RUNS:.0f} %"
                cells.append(text + "".join(f", {SHORT[code]} {100 * found[code] / RUNS:.0f}" for code in others))
            print(f"| {kind} | {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
