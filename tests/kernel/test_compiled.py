"""The compiled step gives the bits of the batch and of the reference, whatever goes in."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.reference.aoi_options import AoiOptions
from softplc.kernel.result import Result
from tests.kernel.sequences import (
    OUTPUTS,
    assert_same,
    dtype_of,
    read_vector,
    run_batch,
    run_reference,
    tuning_of,
    vector_files,
)
from tests.kernel.test_batch import _sequences

pytest.importorskip("numba", reason="numba is not installed: pip install 'softplc[compiled]'")
from softplc.kernel.compiled import aoi as compiled
from softplc.kernel.compiled import loops, signatures

BOTH = pytest.mark.parametrize("precision", ["real", "lreal"])
FILES = [
    pytest.param(path, precision, id=path.stem) for precision in ("real", "lreal") for path in vector_files(precision)
]


@pytest.mark.parametrize(("path", "precision"), FILES)
def test_compiled_step_gives_every_number_of_the_compiled_structured_text(path: Path, precision: str):
    inputs, expected = read_vector(path)

    (outputs,), _ = run_batch([inputs], precision, compiled.step)

    assert_same(outputs, expected)


@BOTH
@settings(max_examples=150, deadline=None)
@given(sequences=_sequences)
def test_compiled_equals_reference_for_any_inputs_enables_and_time_steps(
    precision: str, sequences: list[list[AoiInputs]]
):
    outputs, results = run_batch(sequences, precision, compiled.step)

    for inputs, got, codes in zip(sequences, outputs, results, strict=True):
        expected, expected_codes = run_reference(inputs, precision)
        assert_same(got, expected)
        assert codes == expected_codes


def numbers_of(state: batch.AoiBatchState) -> NDArray[np.float64]:
    return np.array([getattr(state, name) for name in OUTPUTS], np.float64).T


class Twins:
    """The same n axes, of many tunings, stepped by numpy and by the compiled kernel, compared after each scan."""

    def __init__(self, n: int, precision: str, bleeding: float = 0.3) -> None:
        self.rng = rng = np.random.default_rng(n)
        self.n, dtype = n, dtype_of(precision)
        self.states = batch.AoiBatchState(n, dtype), batch.AoiBatchState(n, dtype)
        q_x, q_x_dot, r_x = 10.0 ** rng.uniform(-4, 1, (3, n))
        self.tuning = batch.AoiTuning(
            dtype,
            q_x=q_x,
            q_x_dot=q_x_dot,
            r_x=r_x,
            BleedEnable=rng.random(n) < bleeding,
            BleedThresh=rng.uniform(0, 2, n),
            BleedFactor=rng.uniform(0.5, 1, n),
        )
        self.x = np.zeros(n)

    def step(self, dt: Any = 50.0, enable: Any = True, rows: Any = True, x: Any = None) -> list[int]:
        self.x += self.rng.normal(size=self.n)
        given = {
            "EnableIn": np.array(np.broadcast_to(enable, self.n)),
            "x": self.x if x is None else x,
            "dt": np.array(np.broadcast_to(dt, self.n), np.float64),
            "rows": np.array(np.broadcast_to(rows, self.n)),
        }
        theirs, ours = self.states
        results = batch.step(theirs, self.tuning, **given), compiled.step(ours, self.tuning, **given)
        assert results[0].tolist() == results[1].tolist()
        assert_same(numbers_of(ours), numbers_of(theirs))
        return list(results[1])


@BOTH
@pytest.mark.parametrize("n", [1, 3, 8, 37, 1000])
@pytest.mark.parametrize("bleeding", [0.0, 0.3])
def test_many_axes_equal_numpy_with_one_dt_for_all_and_with_one_for_each(n: int, precision: str, bleeding: float):
    twins = Twins(n, precision, bleeding)
    for _ in range(10):
        assert set(twins.step()) <= {Result.UPDATED, Result.INITIALISED}
    for _ in range(10):
        twins.step(dt=twins.rng.uniform(5, 95, n))


@BOTH
def test_gaps_toggles_skipped_rows_and_nan_in_a_few_of_many_axes_equal_numpy(precision: str):
    n, twins = 100, Twins(100, precision)
    rng = twins.rng
    for _ in range(60):
        dt = np.where(rng.random(n) < 0.1, rng.choice([0.0, -1.0, np.nan, np.inf, 1e-320], n), 50.0)
        x = np.where(rng.random(n) < 0.05, rng.choice([np.nan, np.inf, -np.inf, 1e300], n), twins.x)
        twins.step(dt=dt, enable=rng.random(n) > 0.1, rows=rng.random(n) > 0.1, x=x)
        twins.step()


@BOTH
def test_axes_whose_innovation_variance_is_not_positive_keep_their_gains_among_others_that_go_on(precision: str):
    twins = Twins(20, precision)
    twins.step()
    twins.tuning.r_x[3:5], twins.tuning.r_x[7] = -1e6, np.nan  # changed on the fly

    assert [i for i, code in enumerate(twins.step()) if code == Result.S_NOT_POSITIVE] == [3, 4, 7]
    twins.tuning.r_x[:] = 1.0
    assert set(twins.step()) == {Result.UPDATED}


@BOTH
@pytest.mark.parametrize("dt", [0.0, -50.0, np.nan, 1e-322])
def test_dt_that_is_not_above_zero_in_all_axes_passes_through(precision: str, dt: float):
    twins = Twins(9, precision)
    twins.step()

    assert set(twins.step(dt=dt)) == {Result.DT_INVALID}


def test_inputs_of_other_types_layouts_and_read_only_ones_are_taken():
    twins = Twins(6, "lreal")
    frozen = np.arange(6.0)
    frozen.setflags(write=False)

    for x in (np.arange(6, dtype=np.float32), np.arange(12.0)[::2], frozen, np.arange(6)):
        twins.step(x=x)


def test_no_axes_at_all_are_no_fault():
    Twins(0, "lreal").step()


def test_tuning_with_options_is_stepped_as_numpy_does():
    twins = Twins(2, "lreal")
    twins.tuning.options = AoiBatchOptions(np.float64, [AoiOptions(joseph=True), AoiOptions(min_r=2.0)])

    for _ in range(5):
        twins.step()


@BOTH
def test_machine_code_divides_vectors_and_fuses_nothing(precision: str):
    from numba import njit

    signature = signatures.scan_signature(np.dtype(dtype_of(precision)))
    fresh = njit(signature, error_model="numpy")(loops.scan)  # what comes from the cache cannot be looked into
    code = fresh.inspect_asm(fresh.signatures[0])

    assert not re.findall(r"\bvfn?m(?:add|sub)\w*|\bfn?m(?:add|sub|la|ls)\b", code)
    if re.search(r"\bvdivs[sd]\b", code):  # x86 with AVX
        assert re.search(r"\bvdivp[sd]\b", code)


@BOTH
def test_prepare_tells_that_it_is_ready_when_it_is(precision: str):
    compiled.prepare(dtype_of(precision))

    assert compiled.prepare(dtype_of(precision)) is True


def test_rows_of_the_state_are_where_the_loops_look_for_them():
    state = batch.AoiBatchState(1)
    tuning = tuning_of([AoiInputs(True, 0.0, 50.0, 1.0, 2.0, 3.0, True, 4.0, 5.0)], "lreal")

    for name in ("x_pred", "y_res", "S", "x_dot_pred", "P0", "P1", "P2", "P3", "K0", "K1", "dt_s", "y", "y_dot"):
        assert np.shares_memory(getattr(state, name), state.numbers[getattr(loops, name.upper())]), name
    for name in ("q_x", "q_x_dot", "r_x"):
        assert np.shares_memory(getattr(tuning, name), tuning.numbers[getattr(loops, name.upper())]), name
    assert np.shares_memory(tuning.BleedThresh, tuning.numbers[loops.BLEED_THRESH])
    assert np.shares_memory(tuning.BleedFactor, tuning.numbers[loops.BLEED_FACTOR])
