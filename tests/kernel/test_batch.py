"""Whatever goes in, the batch gives the reference's numbers bit for bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch import aoi as batch
from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.result import Result
from tests.kernel.sequences import OUTPUTS, assert_same, dtype_of, run_batch, run_reference, tuning_of

_SPECIAL = [0.0, -0.0, 1e-300, 1e-45, -1.0, 1e30, 1e300, np.nan, np.inf, -np.inf]
_positions = st.one_of(st.floats(-1e4, 1e4), st.sampled_from(_SPECIAL))
_steps = st.one_of(st.just(50.0), st.floats(0.1, 2000.0), st.sampled_from(_SPECIAL))
_variances = st.one_of(st.floats(0.0, 100.0), st.sampled_from([*_SPECIAL, -0.5]))
any_scan = st.builds(
    AoiInputs,
    EnableIn=st.sampled_from([True, True, True, False]),
    x=_positions,
    dt=_steps,
    q_x=_variances,
    q_x_dot=_variances,
    r_x=_variances,
    BleedEnable=st.booleans(),
    BleedThresh=st.floats(0.0, 1e4),
    BleedFactor=st.floats(0.0, 1.0),
)
_sequences = st.lists(st.lists(any_scan, min_size=1, max_size=12), min_size=1, max_size=5)


@pytest.mark.parametrize("precision", ["real", "lreal"])
@settings(max_examples=150, deadline=None)
@given(sequences=_sequences)
def test_batch_equals_reference_for_any_inputs_enables_and_time_steps(
    precision: str, sequences: list[list[AoiInputs]]
):
    batched, batched_results = run_batch(sequences, precision)

    for inputs, outputs, results in zip(sequences, batched, batched_results, strict=True):
        expected, expected_results = run_reference(inputs, precision)
        assert_same(outputs, expected)
        assert results == expected_results


@pytest.mark.parametrize("precision", ["real", "lreal"])
def test_a_thousand_axes_with_their_own_tuning_equal_a_thousand_references(precision: str):
    rng = np.random.default_rng(5)
    n, scans = 1000, 25
    q_x, q_x_dot, r_x = 10.0 ** rng.uniform(-4, 1, (3, n))
    bleed, thresh, factor = rng.random(n) < 0.3, rng.uniform(0, 2, n), rng.uniform(0.5, 1, n)
    x, dt = np.cumsum(rng.normal(size=(scans, n)), axis=0), rng.uniform(5, 95, (scans, n))
    sequences = [
        [
            AoiInputs(True, x[k, i], dt[k, i], q_x[i], q_x_dot[i], r_x[i], bool(bleed[i]), thresh[i], factor[i])
            for k in range(scans)
        ]
        for i in range(n)
    ]

    batched, _ = run_batch(sequences, precision)

    for inputs, outputs in zip(sequences[::37], batched[::37], strict=True):
        assert_same(outputs, run_reference(inputs, precision)[0])


def step(
    state: batch.AoiBatchState, scan: AoiInputs, x: list[float], EnableIn: bool = True, rows: list[bool] | None = None
) -> list[Result]:
    """One scan of every row with the same tuning and dt."""
    n = len(state)
    codes = batch.step(
        state,
        tuning_of([scan] * n, "real" if state.dtype == np.float32 else "lreal"),
        EnableIn=np.full(n, EnableIn),
        x=np.array(x),
        dt=np.full(n, scan.dt),
        rows=np.array(rows or [True] * n),
    )
    return [Result(code) for code in codes]


@pytest.mark.parametrize("EnableIn", [True, False])
def test_a_row_that_is_not_to_be_stepped_keeps_every_number(EnableIn: bool):
    scan = AoiInputs(True, 3.0, 50.0, 0.01, 0.1, 1.0)
    state = batch.AoiBatchState(2)
    step(state, scan, [1.0, 2.0])
    before = [getattr(state, name)[1] for name in OUTPUTS]

    results = step(state, scan, [5.0, np.nan], EnableIn, rows=[True, False])

    assert before == [getattr(state, name)[1] for name in OUTPUTS]
    assert results[1] == Result.SKIPPED


def test_finite_tells_the_rows_whose_state_is_a_number():
    state = batch.AoiBatchState(3)

    step(state, AoiInputs(True, 3.0, 50.0, 0.01, 0.1, 1.0), [1.0, np.nan, np.inf])

    assert state.finite().tolist() == [True, False, False]


def test_a_cleared_row_is_as_before_the_first_scan_and_the_others_are_as_they_were():
    state, scan = batch.AoiBatchState(2), AoiInputs(True, 3.0, 50.0, 0.01, 0.1, 1.0)
    step(state, scan, [1.0, 2.0])
    before = [getattr(state, name)[0] for name in OUTPUTS]

    state.clear(np.array([False, True]))

    assert [getattr(state, name)[1] for name in OUTPUTS] == [0.0] * len(OUTPUTS)
    assert [getattr(state, name)[0] for name in OUTPUTS] == before


@pytest.mark.parametrize("precision", ["real", "lreal"])
@pytest.mark.filterwarnings("error")
def test_neither_form_lets_a_warning_of_numpy_out(precision: str):
    inputs = [AoiInputs(True, x, 50.0, 1e30, 1e300, 0.0) for x in (1e38, -1e38, np.inf, np.nan, 1e308, -1e308)]

    run_reference(inputs, precision)
    run_batch([inputs], precision)


def test_real_state_is_single_precision_throughout():
    state = batch.AoiBatchState(1, dtype_of("real"))

    step(state, AoiInputs(True, 0.1, 50.0, 0.01, 0.1, 1.0), [0.1])

    assert {getattr(state, name).dtype for name in OUTPUTS if name != "init"} == {np.dtype(np.float32)}


def test_tuning_changes_by_writing_into_its_arrays_and_never_by_putting_another_in_place():
    tuning = tuning_of([AoiInputs(True, 0.0, 50.0, 0.01, 0.1, 1.0, True, 2.0, 0.5)] * 2, "lreal")
    tuning.r_x[1] = 4.0

    assert tuning.numbers[:, 1].tolist() == [0.01, 0.1, 4.0, 2.0, 0.5]
    with pytest.raises(AttributeError, match="r_x is one array for good: write into it"):
        tuning.r_x = np.ones(2)
