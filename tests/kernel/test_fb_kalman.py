"""FB_KalmanFilter: the compiled Structured Text's numbers, reference and batch alike, and what the cure cures."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch import fb_kalman as batch
from softplc.kernel.reference.fb_kalman import FbKalmanInputs, FbKalmanState, fb_kalman_lreal
from softplc.kernel.result import Result
from tests.kernel.fb_kalman_sequences import (
    CALLS,
    EVERYTHING,
    OUTPUTS,
    assert_same,
    read_vector,
    run_batch,
    run_reference,
    vector_files,
)
from tests.kernel.sequences import dtype_of, ulps

FILES = [
    pytest.param(path, precision, id=path.stem) for precision in ("real", "lreal") for path in vector_files(precision)
]
FORMS = sorted(CALLS)
_SPECIAL = [0.0, -0.0, 1e-300, 1e-45, -1.0, 1e30, 1e300, np.nan, np.inf, -np.inf]


def test_there_are_five_sequences_in_each_precision():
    assert [len(vector_files(precision)) for precision in ("real", "lreal")] == [5, 5]


@pytest.mark.parametrize(("path", "precision"), FILES)
def test_reference_gives_every_number_of_the_compiled_structured_text(path: Path, precision: str):
    inputs, expected = read_vector(path)

    outputs, _ = run_reference(inputs, precision)

    assert_same(outputs[:, : len(OUTPUTS)], expected)
    assert ulps(outputs[:, : len(OUTPUTS)], expected, precision) == 0


@pytest.mark.parametrize("precision", ["real", "lreal"])
def test_all_sequences_side_by_side_in_one_batch_give_them_too(precision: str):
    vectors = [read_vector(path) for path in vector_files(precision)]

    outputs, _ = run_batch([inputs for inputs, _ in vectors], precision)

    for got, (_, expected) in zip(outputs, vectors, strict=True):
        assert_same(got[:, : len(OUTPUTS)], expected)


def scans_of(start_at_measurement: bool) -> st.SearchStrategy[FbKalmanInputs]:
    variances = st.one_of(st.floats(0.0, 100.0), st.sampled_from([*_SPECIAL, -0.5]))
    return st.builds(
        FbKalmanInputs,
        MeasuredPosition=st.one_of(st.floats(-1e4, 1e4), st.sampled_from(_SPECIAL)),
        Q=variances,
        R=variances,
        DeltaT=st.one_of(st.just(0.05), st.floats(1e-4, 2.0), st.sampled_from(_SPECIAL)),
        Reset=st.sampled_from([False, False, False, True]),
        EnableIn=st.sampled_from([True, True, True, False]),
        start_at_measurement=st.just(start_at_measurement),
    )


@pytest.mark.parametrize(("variant", "precision"), FORMS)
@pytest.mark.parametrize("start", ["zero", "measurement"])
@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_batch_equals_reference_for_any_inputs_enables_resets_and_time_steps(
    variant: batch.Variant, precision: str, start: batch.Start, data: st.DataObject
):
    scans = scans_of(start == "measurement")
    sequences = data.draw(st.lists(st.lists(scans, min_size=1, max_size=12), min_size=1, max_size=5))

    batched, batched_results = run_batch(sequences, precision, variant, start)

    for inputs, outputs, results in zip(sequences, batched, batched_results, strict=True):
        expected, expected_results = run_reference(inputs, precision, variant)
        assert_same(outputs, expected)
        assert results == expected_results


@pytest.mark.parametrize(("variant", "precision"), FORMS)
def test_a_thousand_axes_with_their_own_tuning_equal_a_thousand_references(variant: batch.Variant, precision: str):
    rng = np.random.default_rng(5)
    n, scans = 1000, 25
    Q, R = 10.0 ** rng.uniform(-4, 1, (2, n))
    x, dt = np.cumsum(rng.normal(size=(scans, n)), axis=0), rng.uniform(0.005, 0.1, (scans, n))
    sequences = [[FbKalmanInputs(x[k, i], Q[i], R[i], dt[k, i]) for k in range(scans)] for i in range(n)]

    batched, _ = run_batch(sequences, precision, variant)

    for inputs, outputs in zip(sequences[::37], batched[::37], strict=True):
        assert_same(outputs, run_reference(inputs, precision, variant)[0])


@pytest.mark.parametrize(("variant", "precision"), FORMS)
@pytest.mark.filterwarnings("error")
def test_neither_form_lets_a_warning_of_numpy_out(variant: batch.Variant, precision: str):
    inputs = [FbKalmanInputs(z, 1e300, 0.0, 0.0) for z in (1e38, -1e38, np.inf, np.nan, 1e308, -1e308)]

    run_reference(inputs, precision, variant)
    run_batch([inputs], precision, variant)


def test_example_program_starts_with_these_numbers():
    outputs, _ = run_reference([FbKalmanInputs(10.5, 0.1, 1.0, 0.1)] * 3, "lreal")

    # given with five decimals
    assert outputs[:, 0] == pytest.approx([5.27612, 8.78894, 11.59966], abs=6e-6)
    assert outputs[:, 1] == pytest.approx([26.24935, 32.09490, 29.16844], abs=6e-6)
    assert outputs[:, 2] == pytest.approx([0.50249, 0.34163, 0.26612], abs=6e-6)


def test_an_object_at_rest_gets_15_units_and_32_units_a_second():
    outputs, _ = run_reference([FbKalmanInputs(10.5, 0.1, 1.0, 0.1)] * 60, "lreal")

    assert outputs[:, 0].max() == pytest.approx(14.997, abs=5e-4)  # for a true 10.5
    assert outputs[:, 1].max() == pytest.approx(32.1, abs=0.05)  # for a true 0


def test_reset_held_is_the_same_jump_in_each_scan():
    inputs = [FbKalmanInputs(10.5, 0.1, 1.0, 0.1)] * 20 + [FbKalmanInputs(10.5, 0.1, 1.0, 0.1, Reset=True)] * 5

    outputs, results = run_reference(inputs, "lreal")

    assert outputs[20:, 0] == pytest.approx(5.276, abs=5e-4)
    assert outputs[20:, 1] == pytest.approx(26.25, abs=5e-3)
    assert results[20:] == [Result.INITIALISED] * 5


def test_a_call_with_no_time_passed_divides_by_zero_as_compiled_text_does():
    state, _ = fb_kalman_lreal(FbKalmanState(), FbKalmanInputs(1.0, 0.1, 1.0, 0.1))

    up, _ = fb_kalman_lreal(state, FbKalmanInputs(9.0, 0.1, 1.0, 0.0))
    at, _ = fb_kalman_lreal(state, FbKalmanInputs(state.x_pos, 0.1, 1.0, 0.0))
    no_variance, _ = fb_kalman_lreal(FbKalmanState(True, p_11=0.0), FbKalmanInputs(1.0, 0.0, 0.0, 0.0))

    assert up.x_vel == np.inf
    assert np.isnan(at.x_vel)  # infinity times no deviation
    assert np.isnan(no_variance.KalmanGain)  # 0/0


@pytest.mark.parametrize(("variant", "precision"), FORMS)
def test_disabled_passes_through_and_the_next_call_has_reset_true(variant: str, precision: str):
    call, on = CALLS[variant, precision], FbKalmanInputs(3.0, 0.1, 1.0, 0.1)
    state, _ = call(FbKalmanState(), on)
    state, _ = call(state, on)

    off, result = call(state, FbKalmanInputs(7.0, 0.1, 1.0, 0.1, EnableIn=False))
    again, started = call(off, on)

    assert (result, off.EstimatedPosition, off.EstimatedVelocity, off.init) == (Result.DISABLED, 7.0, 0.0, False)
    assert (off.x_pos, off.x_vel, off.p_11, off.p_22) == (state.x_pos, state.x_vel, state.p_11, state.p_22)
    assert (again, started) == (call(FbKalmanState(), on)[0], Result.INITIALISED)


@pytest.mark.parametrize("dt", [0.0, -0.0, -0.1, -np.inf, np.nan])
def test_corrected_passes_through_where_no_time_has_passed(dt: float):
    before, _ = run_reference([FbKalmanInputs(3.0, 0.1, 1.0, 0.1)] * 4, "lreal", "corrected")

    after, results = run_reference(
        [FbKalmanInputs(3.0, 0.1, 1.0, 0.1)] * 4 + [FbKalmanInputs(9.0, 0.1, 1.0, dt)], "lreal", "corrected"
    )

    assert results[-1] == Result.DT_INVALID
    assert after[-1, :2].tolist() == [9.0, 0.0]
    assert after[-1, 2:].tolist() == before[-1, 2:].tolist()


def test_corrected_with_no_positive_variance_puts_out_the_prediction():
    inputs = [*[FbKalmanInputs(3.0, 0.1, 1.0, 0.1)] * 4, FbKalmanInputs(9.0, 0.1, -9.0, 0.1)]

    outputs, results = run_reference(inputs, "lreal", "corrected")

    assert results[-1] == Result.S_NOT_POSITIVE
    columns = [EVERYTHING.index(name) for name in ("KalmanGain", "x_vel", "p_11", "p_12", "p_22", "k_vel")]
    assert outputs[-1, columns].tolist() == outputs[-2, columns].tolist()
    assert outputs[-1, 0] == outputs[-2, 0] + 0.1 * outputs[-2, 1]


@pytest.mark.parametrize(("variant", "precision"), FORMS)
def test_started_at_the_measurement_an_object_at_rest_stays_at_rest(variant: str, precision: str):
    inputs = [FbKalmanInputs(10.5, 0.1, 1.0, 0.1, start_at_measurement=True)] * 30

    outputs, _ = run_reference(inputs, precision, variant)

    assert set(outputs[:, 0]) == {10.5}
    assert set(outputs[:, 1]) == {0.0}


@pytest.mark.parametrize("variant", ["as_written", "corrected"])
def test_a_row_that_is_not_to_be_stepped_keeps_every_number(variant: batch.Variant):
    state = batch.FbKalmanBatchState(2)
    tuning = batch.FbKalmanTuning(np.float64, Q=[0.1, 0.1], R=[1.0, 1.0], variant=variant)
    both, dt = np.array([True, True]), np.array([0.1, 0.1])
    batch.step(state, tuning, EnableIn=both, x=np.array([1.0, 2.0]), dt=dt, rows=both)
    before = [array[1] for array in vars(state).values() if isinstance(array, np.ndarray) and array.ndim == 1]

    for enable in (both, ~both):
        codes = batch.step(
            state, tuning, EnableIn=enable, x=np.array([5.0, np.nan]), dt=dt, rows=np.array([True, False])
        )
        after = [array[1] for array in vars(state).values() if isinstance(array, np.ndarray) and array.ndim == 1]
        assert before == after
        assert codes[1] == Result.SKIPPED


def test_finite_tells_the_rows_whose_state_is_a_number_and_clear_starts_them_anew():
    state = batch.FbKalmanBatchState(3)
    tuning = batch.FbKalmanTuning(np.float64, Q=np.full(3, 0.1), R=np.ones(3))
    every = np.full(3, True)
    batch.step(
        state, tuning, EnableIn=every, x=np.array([1.0, np.nan, 1.0]), dt=np.array([0.1, 0.1, 0.0]), rows=every
    )

    finite = state.finite().copy()
    state.clear(~finite)

    assert finite.tolist() == [True, False, False]
    assert (state.init.tolist(), state.p_11[1:].tolist(), state.p_22[1:].tolist()) == (
        [True, False, False],
        [1.0, 1.0],
        [1.0, 1.0],
    )
    assert state.finite().all()


def test_real_state_is_single_precision_throughout():
    state = batch.FbKalmanBatchState(1, dtype_of("real"))

    assert {array.dtype for array in vars(state).values() if isinstance(array, np.ndarray)} - {np.dtype(bool)} == {
        np.dtype(np.float32)
    }
