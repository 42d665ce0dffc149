"""A recording replayed gives what live scans give, on every backend; without numba nothing is missed but speed."""

import doctest
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from softplc.kernel import offline
from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.batch.fb_kalman import FbKalmanBatchState, FbKalmanTuning
from softplc.kernel.batch.fb_kalman import step as fb_kalman_step
from softplc.kernel.compiled import available
from softplc.kernel.offline import AOI_TRACKS, run, run_aoi
from softplc.kernel.reference.aoi_options import AoiOptions
from softplc.kernel.result import Result
from tests.kernel.sequences import dtype_of

ROOT = Path(__file__).parents[2]
needs_numba = pytest.mark.skipif(not available(), reason="numba is not installed: pip install 'softplc[compiled]'")
BACKENDS = pytest.mark.parametrize("backend", ["numpy", pytest.param("compiled", marks=needs_numba)])
BOTH = pytest.mark.parametrize("precision", ["real", "lreal"])


def tuning_of(n: int, precision: str, bleeding: bool = True, options: Any = None) -> batch.AoiTuning:
    rng = np.random.default_rng(n)
    q_x, q_x_dot, r_x = 10.0 ** rng.uniform(-4, 1, (3, n))
    return batch.AoiTuning(
        dtype_of(precision),
        q_x=q_x,
        q_x_dot=q_x_dot,
        r_x=r_x,
        BleedEnable=rng.random(n) < 0.5 * bleeding,
        BleedThresh=rng.uniform(0, 2, n),
        BleedFactor=rng.uniform(0.5, 1, n),
        options=options,
    )


def scan_by_scan(
    tuning: batch.AoiTuning, x: NDArray[np.float64], dt: NDArray[np.float64], enable: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Live, as the service does it; all [t, n]."""
    n = x.shape[1]
    state, rows = batch.AoiBatchState(n, tuning.q_x.dtype), np.full(n, True)
    tracks: dict[str, list[NDArray[Any]]] = {name: [] for name in (*AOI_TRACKS, "result")}
    for t in range(len(x)):
        result = batch.step(state, tuning, EnableIn=enable[t], x=x[t], dt=dt[t], rows=rows)
        for name in AOI_TRACKS:
            tracks[name].append(getattr(state, name).copy())
        tracks["result"].append(result.copy())
    return {name: np.array(track) for name, track in tracks.items()}


def assert_equal(got: Any, expected: Any) -> None:
    assert got.keys() == expected.keys()
    for name, track in got.items():
        assert track.dtype == expected[name].dtype, name
        np.testing.assert_array_equal(track, expected[name], err_msg=name)  # ==, and NaN equals NaN


@BOTH
@BACKENDS
@pytest.mark.parametrize("n", [1, 3, 40])
def test_recording_with_gaps_toggles_nan_and_a_dt_for_each_axis_equals_scan_by_scan(
    n: int, backend: offline.Backend, precision: str
):
    rng = np.random.default_rng(4)
    x = np.cumsum(rng.normal(size=(300, n)), axis=0)
    x[rng.random(x.shape) < 0.02] = np.nan
    dt = np.where(rng.random(x.shape) < 0.5, 50.0, rng.uniform(5, 95, x.shape))
    dt[rng.random(x.shape) < 0.05] = 0.0
    enable = rng.random(x.shape) > 0.05
    tuning = tuning_of(n, precision)

    got = run_aoi(tuning, x, dt, enable, AOI_TRACKS, backend=backend)

    assert_equal(got, scan_by_scan(tuning, x, dt, enable))


@BOTH
@BACKENDS
@pytest.mark.parametrize("n", [1, 40])
def test_long_recording_with_one_dt_equals_scan_by_scan_beyond_where_the_covariance_settles(
    n: int, backend: offline.Backend, precision: str
):
    x = np.cumsum(np.random.default_rng(4).normal(size=(3000, n)), axis=0)
    tuning, enable = tuning_of(n, precision), np.full(x.shape, True)
    tuning.q_x[0], tuning.q_x_dot[0], tuning.r_x[0] = 0.01, 0.1, 4 / 3
    enable[2000:2003] = False  # it starts anew, and settles anew
    dt = np.full(x.shape, 50.0)
    dt[1000], dt[1001] = 20.0, 30.0
    expected = scan_by_scan(tuning, x, dt, enable)
    settled = (np.diff(expected["P0"][:, 0]) == 0.0) & (np.diff(expected["P3"][:, 0]) == 0.0)

    got = run_aoi(tuning, x, dt[:, 0], enable[:, 0], AOI_TRACKS, backend=backend)

    assert settled.sum() > 1500  # else this would not test what it says
    assert_equal(got, expected)


@BACKENDS
@pytest.mark.parametrize("n", [1, 40])
def test_two_halves_of_a_recording_with_the_state_carried_on_equal_the_whole(n: int, backend: offline.Backend):
    x, tuning = np.cumsum(np.random.default_rng(4).normal(size=(200, n)), axis=0), tuning_of(n, "lreal")
    whole = run_aoi(tuning, x, 50.0, backend=backend)
    state = batch.AoiBatchState(n)

    halves = [run_aoi(tuning, part, 50.0, state=state, backend=backend) for part in (x[:77], x[77:])]

    assert_equal({name: np.concatenate([half[name] for half in halves]) for name in whole}, whole)
    np.testing.assert_array_equal(state.y, whole["y"][-1])


@BACKENDS
def test_one_axis_may_be_given_and_comes_back_as_a_plain_sequence(backend: offline.Backend):
    tracks = run_aoi(tuning_of(1, "lreal"), [0.0, 1.0, 2.0], 50.0, backend=backend)

    assert {name: track.shape for name, track in tracks.items()} == {"y": (3,), "y_dot": (3,), "result": (3,)}
    assert tracks["result"].tolist() == [Result.INITIALISED, Result.UPDATED, Result.UPDATED]


def test_any_other_batch_kernel_runs_by_the_same_call():
    x = np.cumsum(np.random.default_rng(4).normal(size=(50, 2)), axis=0)
    state, live = FbKalmanBatchState(2, np.float64), FbKalmanBatchState(2, np.float64)
    tuning = FbKalmanTuning(np.float64, Q=[0.1, 0.2], R=[1.0, 2.0], variant="corrected")
    every = np.full(2, True)

    tracks = run(fb_kalman_step, state, tuning, x, 0.05, tracks=("y_dot", "y"))

    for t, row in enumerate(x):
        results = fb_kalman_step(live, tuning, EnableIn=every, x=row, dt=np.full(2, 0.05), rows=every)
        assert tracks["result"][t].tolist() == results.tolist()
        assert (tracks["y"][t].tolist(), tracks["y_dot"][t].tolist()) == (live.y.tolist(), live.y_dot.tolist())


@BACKENDS
def test_empty_recording_gives_empty_tracks(backend: offline.Backend):
    assert run_aoi(tuning_of(2, "lreal"), np.zeros((0, 2)), 50.0, backend=backend)["y"].shape == (0, 2)


@BACKENDS
@pytest.mark.parametrize(
    ("x", "dt", "message"),
    [
        (np.zeros((5, 3)), 50.0, r"expected x\[t, 2\], found x\[5, 3\]"),
        (np.zeros(5), 50.0, r"expected x\[t, 2\], found x\[5\]"),
        (np.zeros((5, 2)), np.ones(4), r"expected dt as one value, \[5\] or \[5, 2\], found \[4\]"),
    ],
)
def test_shapes_that_do_not_fit_are_named(x: Any, dt: Any, message: str, backend: offline.Backend):
    with pytest.raises(ValueError, match=message):
        run_aoi(tuning_of(2, "lreal"), x, dt, backend=backend)


def test_unknown_track_is_named_with_those_that_exist():
    with pytest.raises(ValueError, match=r"unknown tracks \['z'\], expected some of x_pred, y_res"):
        run_aoi(tuning_of(1, "lreal"), [0.0], 50.0, tracks=("y", "z"))


@BACKENDS
def test_tuning_with_options_runs_with_them_on_any_backend(backend: offline.Backend):
    x = np.cumsum(np.random.default_rng(4).normal(size=(50, 2)), axis=0)
    with_options = tuning_of(2, "lreal", options=AoiBatchOptions(np.float64, [AoiOptions(min_r=5.0)] * 2))

    got = run_aoi(with_options, x, 50.0, backend=backend)

    assert_equal(got, run(batch.step, batch.AoiBatchState(2), with_options, x, 50.0))
    assert (got["y"] != run_aoi(tuning_of(2, "lreal"), x, 50.0)["y"]).any()


def test_auto_compiles_only_what_would_take_numpy_longer_than_starting_numba():
    assert not offline._compiles("auto", 1000, 1)
    assert offline._compiles("auto", 1_000_000, 1) == available()


def test_example_in_the_docstring_is_true():
    assert doctest.testmod(offline) == (0, doctest.testmod(offline).attempted)


_WITHOUT_NUMBA = """
import sys
sys.modules["numba"] = None  # what an import of it finds where it is not installed
import numpy as np
import softplc.kernel, softplc.kernel.offline
from softplc.kernel.compiled import available
from softplc.observers.config import ObserverConfig
from tests.kernel.test_offline import tuning_of
tracks = softplc.kernel.offline.run_aoi(tuning_of(1, "lreal"), np.zeros(5), 50.0)
assert tracks["y"].tolist() == [0.0] * 5
assert not available()
try:
    import softplc.kernel.compiled.aoi
except ModuleNotFoundError as error:
    print(error)
"""


def python(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_without_numba_everything_imports_and_runs_on_numpy_and_the_compiled_kernel_says_what_is_missing():
    assert "numba" in python(_WITHOUT_NUMBA)


def test_the_kernel_and_the_observers_import_no_numba():
    code = "import sys, softplc.kernel.offline, softplc.observers.config; print('numba' in sys.modules)"

    assert python(code) == "False\n"
