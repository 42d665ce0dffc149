"""Calls of FB_KalmanFilter through the reference and the batch, with what comes out side by side."""

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch import fb_kalman as batch
from softplc.kernel.reference import fb_kalman as reference
from softplc.kernel.reference.fb_kalman import FbKalmanInputs, FbKalmanState
from softplc.kernel.result import Result
from tests.kernel.sequences import VECTORS, dtype_of

OUTPUTS = ("EstimatedPosition", "EstimatedVelocity", "KalmanGain", "x_pos", "x_vel", "p_11", "p_12", "p_22")
EVERYTHING = (*OUTPUTS, "k_vel", "y_res", "S", "init")
_BATCH_NAME = {"EstimatedPosition": "y", "EstimatedVelocity": "y_dot"}

Call = Callable[[FbKalmanState, FbKalmanInputs], tuple[FbKalmanState, Result]]
CALLS: dict[tuple[str, str], Call] = {
    ("as_written", "lreal"): reference.fb_kalman_lreal,
    ("as_written", "real"): reference.fb_kalman_real,
    ("corrected", "lreal"): reference.fb_kalman_corrected_lreal,
    ("corrected", "real"): reference.fb_kalman_corrected_real,
}


def vector_files(precision: str) -> list[Path]:
    return sorted(VECTORS.glob(f"fb_kalman_*_{precision}.csv"))


def read_vector(path: Path) -> tuple[list[FbKalmanInputs], NDArray[np.float64]]:
    """The inputs of each call, and OUTPUTS after it as float64[calls, 8]."""
    with path.open(encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    names = ("MeasuredPosition", "Q", "R", "DeltaT")
    inputs = [FbKalmanInputs(*(float(row[k]) for k in names), Reset=float(row["Reset"]) != 0) for row in rows]
    outputs = np.array([[float(row[k]) for k in OUTPUTS] for row in rows])
    if path.stem.endswith("_real"):  # written as the shortest decimal of a float32
        outputs = outputs.astype(np.float32).astype(np.float64)
    return inputs, outputs


def run_reference(
    inputs: Sequence[FbKalmanInputs], precision: str, variant: str = "as_written"
) -> tuple[NDArray[np.float64], list[Result]]:
    """EVERYTHING after each call as float64[calls, 12], and each call's result."""
    state, outputs, results = FbKalmanState(), [], []
    for scan in inputs:
        state, result = CALLS[variant, precision](state, scan)
        outputs.append([float(getattr(state, name)) for name in EVERYTHING])
        results.append(result)
    return np.array(outputs, np.float64), results


def states(inputs: Sequence[FbKalmanInputs], variant: str = "as_written") -> list[FbKalmanState]:
    """The state after each call, in double precision."""
    state, after = FbKalmanState(), []
    for scan in inputs:
        state, _ = CALLS[variant, "lreal"](state, scan)
        after.append(state)
    return after


def run_batch(
    sequences: Sequence[Sequence[FbKalmanInputs]],
    precision: str,
    variant: batch.Variant = "as_written",
    start: batch.Start = "zero",
) -> tuple[list[NDArray[np.float64]], list[list[Result]]]:
    """Several sequences as rows of one batch; a row whose sequence has ended is stepped no more.

    Reset of an enabled row is given as the batch takes it: `init` is cleared before the scan.
    """
    n, dtype = len(sequences), dtype_of(precision)
    state = batch.FbKalmanBatchState(n, dtype)
    outputs: list[list[list[float]]] = [[] for _ in range(n)]
    results: list[list[Result]] = [[] for _ in range(n)]
    for k in range(max(map(len, sequences))):
        scans = [one[min(k, len(one) - 1)] for one in sequences]
        rows = np.array([k < len(one) for one in sequences])
        state.init[np.array([scan.Reset for scan in scans]) & rows] = False
        tuning = batch.FbKalmanTuning(
            dtype, Q=[scan.Q for scan in scans], R=[scan.R for scan in scans], variant=variant, start=start
        )
        codes = batch.step(
            state,
            tuning,
            EnableIn=np.array([scan.EnableIn for scan in scans]),
            x=np.array([scan.MeasuredPosition for scan in scans]),
            dt=np.array([scan.DeltaT for scan in scans]),
            rows=rows,
        )
        after = np.array([getattr(state, _BATCH_NAME.get(name, name)) for name in EVERYTHING], np.float64)
        for row in np.flatnonzero(rows):
            outputs[row].append(after[:, row].tolist())
            results[row].append(Result(codes[row]))
    return [np.array(one, np.float64) for one in outputs], results


def assert_same(got: NDArray[np.float64], expected: NDArray[np.float64]) -> None:
    """Every number equal, NaN equal to NaN; says which output parts first."""
    different = ~((got == expected) | (np.isnan(got) & np.isnan(expected)))
    if different.any():
        scan, column = np.argwhere(different)[0]
        raise AssertionError(
            f"call {scan}, {EVERYTHING[column]}: {got[scan, column]!r} is not {expected[scan, column]!r}"
        )
