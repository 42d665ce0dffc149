"""The options: off they are the AOI itself, on they are the same numbers as scalars and as arrays."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.reference.aoi_options import (
    AoiOptions,
    AoiOptionsState,
    aoi_options_lreal,
    aoi_options_real,
)
from softplc.kernel.result import Result
from tests.kernel.sequences import OUTPUTS, assert_same, dtype_of, outputs_of, run_reference, tuning_of
from tests.kernel.test_batch import any_scan

PRECISIONS = ["real", "lreal"]
_limits = st.sampled_from([(-np.inf, np.inf), (0.1, 0.3), (0.0, 0.5), (0.9, 2.0), (-np.inf, 0.05), (5.0, np.inf)])
any_options = st.builds(
    AoiOptions,
    joseph=st.booleans(),
    min_r=st.sampled_from([-np.inf, 0.0, 0.01, 30.0]),
    K0_limits=_limits,
    K1_limits=_limits,
    q_exponents=st.tuples(st.integers(0, 3), st.integers(0, 3)),
    white_accel=st.booleans(),
    r_density=st.booleans(),
    bleed_on_innovation=st.booleans(),
    bleed_velocity=st.sampled_from([None, 0.1, 10.0, 1e300]),
    gate=st.sampled_from([None, 0.01, 3.0, 1e300]),
    gate_most=st.integers(0, 3),
    reinitialise=st.booleans(),
    reference=st.sampled_from([None, "first_sample", 0.0, 12345.678, 2.0**40]),
)
EXTRA = (*OUTPUTS, "offset", "in_a_row", "rejected")


def run_scalar(inputs: Sequence[AoiInputs], options: AoiOptions, precision: str) -> tuple[np.ndarray, list[Result]]:
    """EXTRA after each scan, and each scan's result."""
    step = aoi_options_real if precision == "real" else aoi_options_lreal
    state, outputs, results = AoiOptionsState(), [], []
    for scan in inputs:
        state, result = step(state, scan, options)
        outputs.append((*outputs_of(state.aoi), state.offset, state.in_a_row, state.rejected))
        results.append(result)
    return np.array(outputs, np.float64), results


def run_rows(
    sequences: Sequence[Sequence[AoiInputs]], options: Sequence[AoiOptions], precision: str
) -> tuple[list[np.ndarray], list[list[Result]]]:
    """Several sequences as rows of one batch; a row whose sequence has ended is stepped no more."""
    n = len(sequences)
    state = batch.AoiBatchState(n, dtype_of(precision))
    together = AoiBatchOptions(dtype_of(precision), options)
    outputs: list[list[list[float]]] = [[] for _ in range(n)]
    results: list[list[Result]] = [[] for _ in range(n)]
    for k in range(max(map(len, sequences))):
        scans = [one[min(k, len(one) - 1)] for one in sequences]
        rows = np.array([k < len(one) for one in sequences])
        tuning = tuning_of(scans, precision)
        tuning.options = together
        codes = batch.step(
            state,
            tuning,
            EnableIn=np.array([scan.EnableIn for scan in scans]),
            x=np.array([scan.x for scan in scans]),
            dt=np.array([scan.dt for scan in scans]),
            rows=rows,
        )
        after = np.array([getattr(state, name) for name in EXTRA], np.float64)
        for row in np.flatnonzero(rows):
            outputs[row].append(after[:, row].tolist())
            results[row].append(Result(codes[row]))
    return [np.array(one, np.float64) for one in outputs], results


@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=150, deadline=None)
@given(inputs=st.lists(any_scan, min_size=1, max_size=15))
def test_with_every_option_off_it_is_the_aoi_number_for_number(precision: str, inputs: list[AoiInputs]):
    expected, expected_results = run_reference(inputs, precision)

    outputs, results = run_scalar(inputs, AoiOptions(), precision)

    assert_same(outputs[:, : len(OUTPUTS)], expected)
    assert results == expected_results


@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=250, deadline=None)
@given(
    rows=st.lists(st.tuples(st.lists(any_scan, min_size=1, max_size=12), any_options), min_size=1, max_size=5),
)
def test_batch_equals_reference_for_any_options_inputs_enables_and_time_steps(
    precision: str, rows: list[tuple[list[AoiInputs], AoiOptions]]
):
    batched, batched_results = run_rows([inputs for inputs, _ in rows], [options for _, options in rows], precision)

    for (inputs, options), outputs, results in zip(rows, batched, batched_results, strict=True):
        expected, expected_results = run_scalar(inputs, options, precision)
        assert_same(outputs, expected, EXTRA)
        assert results == expected_results


@pytest.mark.parametrize("precision", PRECISIONS)
def test_five_hundred_axes_each_with_its_own_options_equal_five_hundred_references(precision: str):
    rng = np.random.default_rng(5)
    n, scans = 500, 40
    x = np.cumsum(rng.normal(size=(scans, n)), axis=0) + 50 * (rng.random((scans, n)) < 0.1)
    dt = np.where(rng.random((scans, n)) < 0.05, 0.0, rng.uniform(5, 95, (scans, n)))
    r_x = np.where(rng.random((scans, n)) < 0.02, -9.0, 10.0 ** rng.uniform(-3, 1, n))
    enable = rng.random((scans, n)) > 0.02
    sequences, options = [], []
    for i in range(n):
        bleed = (bool(rng.random() < 0.5), rng.uniform(0, 2), rng.uniform(0.5, 1))
        q = 10.0 ** rng.uniform(-4, 1, 2)
        sequences.append(
            [AoiInputs(bool(enable[k, i]), x[k, i], dt[k, i], *q, r_x[k, i], *bleed) for k in range(scans)]
        )
        options.append(
            AoiOptions(
                joseph=bool(rng.random() < 0.5),
                min_r=rng.choice([-np.inf, 0.1]),
                K0_limits=rng.choice([(-np.inf, np.inf), (0.1, 0.5)]),
                K1_limits=rng.choice([(-np.inf, np.inf), (0.1, 2.0)]),
                q_exponents=tuple(rng.integers(0, 4, 2)),
                white_accel=bool(rng.random() < 0.3),
                r_density=bool(rng.random() < 0.3),
                bleed_on_innovation=bool(rng.random() < 0.5),
                bleed_velocity=rng.choice([None, 1.0]),
                gate=rng.choice([None, 3.0]),
                gate_most=int(rng.integers(0, 4)),
                reinitialise=bool(rng.random() < 0.5),
                reference=[None, "first_sample", 1000.0][rng.integers(3)],
            )
        )

    batched, batched_results = run_rows(sequences, options, precision)

    for inputs, chosen, outputs, results in zip(sequences, options, batched, batched_results, strict=True):
        expected, expected_results = run_scalar(inputs, chosen, precision)
        assert_same(outputs, expected, EXTRA)
        assert results == expected_results
    seen = {result for results in batched_results for result in results}
    assert seen == {
        Result.UPDATED,
        Result.INITIALISED,
        Result.DISABLED,
        Result.DT_INVALID,
        Result.S_NOT_POSITIVE,
        Result.REJECTED,
    }


def test_rows_without_options_in_a_batch_with_options_are_the_plain_aoi():
    rng = np.random.default_rng(6)
    x = np.cumsum(rng.normal(size=60))
    inputs = [AoiInputs(True, z, 50.0, 0.01, 0.1, 4 / 3, True, 0.5, 0.9) for z in x]
    everything = AoiOptions(True, 1.0, (0.0, 0.5), (0.0, 1.0), (1, 2), True, True, True, 1.0, 3.0, 2, True, 5.0)

    (plain, _), _ = run_rows([inputs, inputs], [AoiOptions(), everything], "lreal")

    assert_same(plain[:, : len(OUTPUTS)], run_reference(inputs, "lreal")[0])


def test_a_row_that_is_not_to_be_stepped_keeps_every_number_of_its_options():
    state = batch.AoiBatchState(2)
    scan = AoiInputs(True, 3.0, 50.0, 0.01, 0.1, 1.0)
    tuning = tuning_of([scan, scan], "lreal")
    tuning.options = AoiBatchOptions(np.float64, [AoiOptions(gate=3.0, gate_most=1, reference="first_sample")] * 2)

    def step(x: float, rows: list[bool], EnableIn: bool) -> list[int]:
        codes = batch.step(
            state,
            tuning,
            EnableIn=np.full(2, EnableIn),
            x=np.full(2, x),
            dt=np.full(2, 50.0),
            rows=np.array(rows),
        )
        return codes.tolist()

    for x in (1.0, 1.1, 90.0):
        step(x, [True, True], True)
    before = [getattr(state, name)[1] for name in EXTRA]
    for x, EnableIn in ((90.0, True), (np.nan, True), (5.0, False)):
        assert step(x, [True, False], EnableIn)[1] == Result.SKIPPED

    assert [getattr(state, name)[1] for name in EXTRA] == before
    assert before[-3:] == [1.0, 1, 1]

    state.clear(np.array([False, True]))
    assert [getattr(state, name)[1] for name in EXTRA] == [*[0.0] * (len(EXTRA) - 1), 1]  # but what was counted


def test_a_fixed_reference_reaches_a_row_with_its_first_step_and_not_before():
    state, scan = batch.AoiBatchState(2), AoiInputs(True, 3.0, 50.0, 0.01, 0.1, 1.0)
    tuning = tuning_of([scan, scan], "lreal")
    tuning.options = AoiBatchOptions(np.float64, [AoiOptions(reference=7.0)] * 2)
    every = np.full(2, True)

    batch.step(state, tuning, EnableIn=every, x=np.full(2, 9.0), dt=50 * np.ones(2), rows=np.array([True, False]))

    assert (state.offset.tolist(), state.y.tolist()) == ([7.0, 0.0], [2.0, 0.0])
