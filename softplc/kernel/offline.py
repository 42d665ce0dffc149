"""An observer over recorded arrays: the same arithmetic as live, scan by scan, with nothing around it.

>>> import numpy as np
>>> from softplc.kernel import AoiTuning
>>> from softplc.kernel.offline import run_aoi
>>> noise = {"q_x": [0.01], "q_x_dot": [0.1], "r_x": [4 / 3]}
>>> tuning = AoiTuning("f8", **noise, BleedEnable=[False], BleedThresh=[0.0], BleedFactor=[1.0])
>>> run_aoi(tuning, x=np.array([0.0, 1.0, 2.0]), dt=50.0, backend="numpy")["y"].round(6).tolist()
[0.0, 0.326312, 0.811503]
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi import AoiBatchState, AoiTuning
from softplc.kernel.compiled import available

Backend = Literal["auto", "numpy", "compiled"]
AOI_TRACKS = ("x_pred", "y_res", "S", "x_dot_pred", "P0", "P1", "P2", "P3", "K0", "K1", "dt_s", "y", "y_dot")
"""What `run_aoi` can keep of each scan, named as in the Structured Text; the paper's P00, P01, P11 are P0, P1, P3."""

_WORTH_COMPILING = 1.0  # s that numpy would take: less than starting numba


class State(Protocol):
    """The state of a batch kernel: n axes, arrays[n] as attributes, `y` and `y_dot` among them."""

    dtype: np.dtype[Any]

    def __len__(self) -> int: ...


Step = Callable[..., NDArray[np.uint8]]
"""The step of a batch kernel: step(state, tuning, *, EnableIn, x, dt, rows), all arrays[n]."""


def run(
    step: Step,
    state: State,
    tuning: Any,
    x: ArrayLike,
    dt: ArrayLike,
    enable: ArrayLike = True,
    tracks: Sequence[str] = ("y", "y_dot"),
) -> Mapping[str, NDArray[Any]]:
    """A recording through any batch kernel: its attributes `tracks` after each scan, and `result`.

    `x` is [t, n], or [t] for one axis; u. `dt` is in the unit that the step takes, seconds or, for the AOI,
    milliseconds. It and `enable` are single values, [t] for all axes, or shaped as x. The tracks have the shape of x.
    `state` is where the recording begins, new or carried on, and afterwards as after the last scan. Where x is NaN
    the kernel gets NaN: leave such rows out, or disable them there. Raises ValueError when a shape does not fit.
    """
    samples, steps, enables = _shaped(state, x, dt, enable)
    rows = np.ones(len(state), np.bool_)
    kept = {name: np.empty(samples.shape, getattr(state, name).dtype) for name in tracks}
    results = np.empty(samples.shape, np.uint8)
    each_dt, each_enable = np.broadcast_to(steps, samples.shape), np.broadcast_to(enables, samples.shape)
    for t in range(len(samples)):
        results[t] = step(state, tuning, EnableIn=each_enable[t], x=samples[t], dt=each_dt[t], rows=rows)
        for name, track in kept.items():
            track[t] = getattr(state, name)
    return {name: track.reshape(np.shape(x)) for name, track in (kept | {"result": results}).items()}


def run_aoi(
    tuning: AoiTuning,
    x: ArrayLike,
    dt: ArrayLike,
    enable: ArrayLike = True,
    tracks: Sequence[str] = ("y", "y_dot"),
    *,
    state: AoiBatchState | None = None,
    backend: Backend = "auto",
) -> Mapping[str, NDArray[Any]]:
    """`run` for the AOI, `dt` in milliseconds; any of AOI_TRACKS. Every backend gives the same bits.

    compiled needs the extra of that name (ModuleNotFoundError without it) and replays one axis a thousand times as
    fast as numpy can, which has nothing to vectorise there. auto takes it where numpy would need more than a second,
    since starting it takes that long. Tuning with options runs on numpy. `state`: where it begins; new when left out.
    """
    state = state if state is not None else AoiBatchState(len(tuning.q_x), tuning.q_x.dtype)
    unknown = set(tracks) - set(AOI_TRACKS)
    if unknown:
        raise ValueError(f"unknown tracks {sorted(unknown)}, expected some of {', '.join(AOI_TRACKS)}")
    if backend not in ("auto", "numpy", "compiled"):
        raise ValueError(f"unknown backend {backend!r}, expected auto, numpy or compiled")
    samples, steps, enables = _shaped(state, x, dt, enable)
    if tuning.options is not None or not _compiles(backend, *samples.shape):
        return run(batch.step, state, tuning, x, dt, enable, tracks)

    from softplc.kernel.compiled import aoi as compiled  # noqa: PLC0415  # imports numba

    everything = not set(tracks) <= {"y", "y_dot"}
    out, results = compiled.replay(state, tuning, EnableIn=enables, x=samples, dt=steps, everything=everything)
    rows = AOI_TRACKS if everything else AOI_TRACKS[-2:]
    kept = {name: out[rows.index(name)] for name in tracks} | {"result": results}
    return {name: track.reshape(np.shape(x)) for name, track in kept.items()}


def _compiles(backend: Backend, scans: int, n: int) -> bool:
    """Whether the compiled kernel shall do it; numpy takes some 20 µs for each scan and 20 ns for each sample."""
    if backend == "auto":
        return available() and scans * (20e-6 + n * 20e-9) > _WORTH_COMPILING
    return backend == "compiled"


def _shaped(
    state: State, x: ArrayLike, dt: ArrayLike, enable: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """x as [t, n], dt and enable as [t, n] or [t, 1]."""
    samples = np.asarray(x, np.float64)
    shape = samples.shape
    if samples.ndim == 1:
        samples = samples[:, np.newaxis]
    if samples.ndim != 2 or samples.shape[1] != len(state):
        raise ValueError(f"expected x[t, {len(state)}]{' or x[t]' * (len(state) == 1)}, found x{list(shape)}")

    def each(name: str, values: NDArray[Any]) -> NDArray[Any]:
        if values.ndim == 0:
            values = np.broadcast_to(values, shape[:1])
        if values.shape not in {shape, shape[:1], samples.shape}:
            raise ValueError(
                f"expected {name} as one value, [{shape[0]}] or {list(shape)}, found {list(values.shape)}"
            )
        return values[:, np.newaxis] if values.ndim == 1 else values

    return samples, each("dt", np.asarray(dt, np.float64)), each("enable", np.asarray(enable, np.bool_))
