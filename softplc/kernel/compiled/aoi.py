"""The Logix AOI compiled: `batch.aoi.step` on the same state and tuning, the same bits, less time.

While every row is enabled, initialised and has a valid dt, one loop without branches goes over all rows; otherwise
each row goes by itself, in the order of the Structured Text. The loops are in `compiled.loops`.
"""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi import AoiBatchState, AoiTuning, Flags
from softplc.kernel.compiled import loops, signatures
from softplc.kernel.compiled.jit import compile_now

_scans: dict[int, Any] = {}  # by the size of a number in bytes
_replays: dict[int, Any] = {}


def prepare(dtype: DTypeLike) -> bool:
    """Make `step` ready for states of this precision; False when that meant compiling, which takes seconds.

    A step without it does the same. Ready is ready: True at once. From the cache of an earlier process: less
    than a second.
    """
    wanted = np.dtype(dtype)
    cached = True
    if wanted.itemsize not in _scans:
        _scans[wanted.itemsize], cached = compile_now(loops.scan, signatures.scan_signature(wanted))
    return cached


def step(
    state: AoiBatchState,
    tuning: AoiTuning,
    *,
    EnableIn: Flags,
    x: NDArray[Any],
    dt: NDArray[Any],
    rows: Flags,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true, as `batch.aoi.step`: `x` in u, `dt` in ms, all arrays[n].

    Returns the Result of each row, valid until the next step. Tuning with options is stepped by numpy. Arrays that
    are not contiguous, not writable or not float64 are copied.
    """
    if tuning.options is not None:
        return batch.step(state, tuning, EnableIn=EnableIn, x=x, dt=dt, rows=rows)
    numbers = state.numbers
    try:
        scan = _scans[numbers.itemsize]
    except KeyError:
        prepare(numbers.dtype)
        scan = _scans[numbers.itemsize]
    try:
        scan(numbers, state.bytes, tuning.numbers, tuning.BleedEnable, EnableIn, x, dt, rows)
    except TypeError:
        x, dt = np.array(x, np.float64), np.array(dt, np.float64)
        EnableIn, rows = np.array(EnableIn, np.bool_), np.array(rows, np.bool_)
        scan(numbers, state.bytes, tuning.numbers, tuning.BleedEnable, EnableIn, x, dt, rows)
    return state._scratch.result


def replay(
    state: AoiBatchState,
    tuning: AoiTuning,
    *,
    EnableIn: NDArray[np.bool_],
    x: NDArray[np.float64],
    dt: NDArray[np.float64],
    everything: bool = True,
) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    """All scans of a recording: x[t, n] in u; EnableIn and dt in ms [t, n], or [t, 1] for the same in all axes.

    Returns the state after each scan, [13, t, n] with the rows of `AoiBatchState.numbers`, or without `everything`
    [2, t, n] with y and y_dot, and the results [t, n]. The state is then as after the last scan. Raises ValueError
    when the tuning has options, or the shapes do not fit.
    """
    scans, n = x.shape
    if tuning.options is not None:
        raise ValueError("tuning with options is not compiled: replay it with batch.aoi.step")
    if n != len(state) or any(one.shape not in {(scans, n), (scans, 1)} for one in (EnableIn, dt)):
        raise ValueError(
            f"expected x[t, {len(state)}] with EnableIn and dt [t, {len(state)}] or [t, 1], found x{list(x.shape)}, "
            f"EnableIn{list(EnableIn.shape)}, dt{list(dt.shape)}"
        )
    if state.dtype.itemsize not in _replays:
        compiled, _ = compile_now(loops.replay, signatures.replay_signature(state.dtype))
        _replays[state.dtype.itemsize] = compiled
    out = np.empty((13 if everything else 2, scans, n), state.dtype)
    results = np.empty((scans, n), np.uint8)
    given = [
        np.require(one, kind, ("C", "W")) for one, kind in ((EnableIn, np.bool_), (x, np.float64), (dt, np.float64))
    ]
    _replays[state.dtype.itemsize](
        state.numbers, state.bytes, tuning.numbers, tuning.BleedEnable, *given, out, results
    )
    return out, results
