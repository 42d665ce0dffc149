"""Inputs scan by scan, through the reference and through the batch, with what comes out side by side."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real
from softplc.kernel.result import Result

VECTORS = Path(__file__).parent / "vectors"
OUTPUTS = ("y", "y_dot", "x_pred", "x_dot_pred", "P0", "P1", "P2", "P3", "K0", "K1", "S", "y_res", "init", "dt_s")
_INPUTS = ("EnableIn", "x", "dt_ms", "q_x", "q_x_dot", "r_x", "BleedEnable", "BleedThresh", "BleedFactor")
_TUNING = _INPUTS[3:]
_FLAGS = ("EnableIn", "BleedEnable")


def vector_files(precision: str) -> list[Path]:
    return sorted(VECTORS.glob(f"aoi_*_{precision}.csv"))


def read_vector(path: Path) -> tuple[list[AoiInputs], NDArray[np.float64]]:
    """The inputs of each scan, and OUTPUTS after it as float64[scans, 14]."""
    with path.open(encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    inputs = [AoiInputs(*(float(row[k]) != 0 if k in _FLAGS else float(row[k]) for k in _INPUTS)) for row in rows]
    outputs = np.array([[float(row[k]) for k in OUTPUTS] for row in rows])
    if path.stem.endswith("_real"):  # written as the shortest decimal of a float32
        outputs = outputs.astype(np.float32).astype(np.float64)
    return inputs, outputs


def dtype_of(precision: str) -> Any:
    return np.float32 if precision == "real" else np.float64


def outputs_of(state: AoiState) -> tuple[float, ...]:
    """OUTPUTS of a reference state."""
    return (
        state.y,
        state.y_dot,
        state.x_pred,
        state.x_dot_pred,
        *state.P,
        state.K0,
        state.K1,
        state.S,
        state.y_res,
        float(state.init),
        state.dt_s,
    )


def run_reference(inputs: Sequence[AoiInputs], precision: str) -> tuple[NDArray[np.float64], list[Result]]:
    """OUTPUTS after each scan as float64[scans, 14], and each scan's result."""
    step = aoi_real if precision == "real" else aoi_lreal
    state, outputs, results = AoiState(), [], []
    for scan in inputs:
        state, result = step(state, scan)
        outputs.append(outputs_of(state))
        results.append(result)
    return np.array(outputs, np.float64), results


def tuning_of(inputs: Sequence[AoiInputs], precision: str) -> batch.AoiTuning:
    """The tuning of one scan over all rows."""
    columns = {name: [getattr(one, name) for one in inputs] for name in _TUNING}
    return batch.AoiTuning(dtype_of(precision), **columns)


def run_batch(
    sequences: Sequence[Sequence[AoiInputs]], precision: str, step: Any = batch.step
) -> tuple[list[NDArray[np.float64]], list[list[Result]]]:
    """Several sequences as rows of one batch; a row whose sequence has ended is stepped no more."""
    n = len(sequences)
    state = batch.AoiBatchState(n, dtype_of(precision))
    outputs: list[list[list[float]]] = [[] for _ in range(n)]
    results: list[list[Result]] = [[] for _ in range(n)]
    for k in range(max(map(len, sequences))):
        scans = [one[min(k, len(one) - 1)] for one in sequences]
        rows = np.array([k < len(one) for one in sequences])
        codes = step(
            state,
            tuning_of(scans, precision),
            EnableIn=np.array([scan.EnableIn for scan in scans]),
            x=np.array([scan.x for scan in scans]),
            dt=np.array([scan.dt for scan in scans]),
            rows=rows,
        )
        after = np.array([getattr(state, name) for name in OUTPUTS], np.float64)
        for row in np.flatnonzero(rows):
            outputs[row].append(after[:, row].tolist())
            results[row].append(Result(codes[row]))
    return [np.array(one, np.float64) for one in outputs], results


def ulps(got: NDArray[np.float64], expected: NDArray[np.float64], precision: str) -> int:
    """Largest distance in units of the last place; NaN equals NaN, +0 equals -0."""
    kind = np.int32 if precision == "real" else np.int64
    a, b = (array.astype(dtype_of(precision)).view(kind).astype(object) for array in (got, expected))
    offset = -(2 ** (31 if precision == "real" else 63))
    a, b = (np.where(array < 0, offset - array, array) for array in (a, b))
    same = (got == expected) | (np.isnan(got) & np.isnan(expected))
    return int(np.where(same, 0, abs(a - b)).max())


def assert_same(got: NDArray[np.float64], expected: NDArray[np.float64], names: Sequence[str] = OUTPUTS) -> None:
    """Every number equal, NaN equal to NaN; says which output parts first."""
    different = ~((got == expected) | (np.isnan(got) & np.isnan(expected)))
    if different.any():
        scan, column = np.argwhere(different)[0]
        raise AssertionError(f"scan {scan}, {names[column]}: {got[scan, column]!r} is not {expected[scan, column]!r}")
