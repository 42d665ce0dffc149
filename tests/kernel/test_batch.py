"""Whatever goes in, the batch gives the reference's numbers bit for bit."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_steady import ROWS, slices
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real
from softplc.kernel.result import Result
from tests.kernel.sequences import OUTPUTS, assert_same, dtype_of, outputs_of, run_batch, run_reference, tuning_of

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


class Rows:
    """n axes of many tunings as one batch, whose rows may be stepped by the reference beside it."""

    def __init__(self, n: int, precision: str) -> None:
        self.rng = rng = np.random.default_rng(11)
        self.n, self.precision, real = n, precision, dtype_of(precision)
        q_x, q_x_dot, r_x = 10.0 ** rng.uniform(-4, 1, (3, n))
        self.tuning = batch.AoiTuning(
            real,
            q_x=q_x,
            q_x_dot=q_x_dot,
            r_x=r_x,
            BleedEnable=rng.random(n) < 0.3,
            BleedThresh=rng.uniform(0, 2, n),
            BleedFactor=rng.uniform(0.5, 1, n),
        )
        self.state = batch.AoiBatchState(n, real)
        self.state.init[:] = True
        for row in self.state.numbers:
            row[:] = rng.choice([0.0, -0.0, 1.0, 1e-320, *rng.uniform(-1, 5, 4)], n)

    def make_covariances_sound(self) -> None:
        """So that every S is positive."""
        state = self.state
        state.P0[:], state.P1[:], state.P2[:], state.P3[:] = np.abs(state.P0), 0.0, 0.0, np.abs(state.P3)

    def outputs(self, row: int) -> tuple[float, ...]:
        return tuple(float(getattr(self.state, name)[row]) for name in OUTPUTS)

    def reference_of(self, row: int) -> AoiState:
        y, y_dot, x_pred, x_dot_pred, P0, P1, P2, P3, K0, K1, S, y_res, init, dt_s = (
            getattr(self.state, name)[row] for name in OUTPUTS
        )
        P = (P0, P1, P2, P3)
        return AoiState(bool(init), dt_s, x_pred, x_dot_pred, P, K0, K1, S, y_res, y, y_dot)

    def step_beside_reference(self, dt: NDArray[np.float64], watched: Sequence[int]) -> list[Result]:
        """Step all rows; every bit of the watched ones must be the reference's. The results of all rows."""
        x = self.rng.choice([0.0, -0.0, *self.rng.normal(size=6)], self.n)
        before = {row: self.reference_of(row) for row in watched}
        every, tuning = np.full(self.n, True), self.tuning
        codes = batch.step(self.state, tuning, EnableIn=every, x=x, dt=dt, rows=every).tolist()
        step = aoi_real if self.precision == "real" else aoi_lreal
        for row, state in before.items():
            q_x, q_x_dot, r_x, BleedThresh, BleedFactor = tuning.numbers[:, row]
            bleed = bool(tuning.BleedEnable[row]), BleedThresh, BleedFactor
            with np.errstate(all="ignore"):
                after, result = step(state, AoiInputs(True, x[row], dt[row], q_x, q_x_dot, r_x, *bleed))
            assert result == codes[row], row
            assert [one.hex() for one in self.outputs(row)] == [float(one).hex() for one in outputs_of(after)], row
        return [Result(code) for code in codes]


@pytest.mark.parametrize("precision", ["real", "lreal"])
@pytest.mark.parametrize("same_dt", [True, False])
def test_states_made_by_hand_go_on_with_every_bit_of_the_reference_signed_zeros_too(precision: str, same_dt: bool):
    n = 64
    rows = Rows(n, precision)

    for _ in range(5):
        dt = np.full(n, 50.0) if same_dt else rows.rng.uniform(5, 95, n)
        rows.step_beside_reference(dt, range(n))


@pytest.mark.parametrize("precision", ["real", "lreal"])
@pytest.mark.parametrize("same_dt", [True, False])
def test_more_axes_than_fit_one_part_are_all_stepped(precision: str, same_dt: bool):
    n = 2 * ROWS + 3
    rows = Rows(n, precision)
    rows.make_covariances_sound()
    edges = [edge for these in slices(n) for edge in (these.start, these.stop - 1)]

    assert len(edges) == 6
    for _ in range(3):
        dt = np.full(n, 50.0) if same_dt else rows.rng.uniform(5, 95, n)
        assert set(rows.step_beside_reference(dt, edges)) == {Result.UPDATED}


@pytest.mark.parametrize("same_dt", [True, False])
def test_an_axis_out_of_the_normal_course_in_one_part_is_told_from_those_in_its_own_and_in_others(same_dt: bool):
    n = 2 * ROWS + 3
    rows = Rows(n, "lreal")
    rows.make_covariances_sound()
    rows.tuning.r_x[[5, n - 1]] = -1e6, np.nan
    dt = np.full(n, 50.0) if same_dt else rows.rng.uniform(5, 95, n)
    if not same_dt:
        dt[7], dt[ROWS] = np.nan, -50.0

    for _ in range(3):
        codes = rows.step_beside_reference(dt, [0, 5, 6, 7, ROWS - 1, ROWS, ROWS + 1, n - 2, n - 1])

        stuck = {i: code for i, code in enumerate(codes) if code != Result.UPDATED}
        expected = {5: Result.S_NOT_POSITIVE, n - 1: Result.S_NOT_POSITIVE}
        assert stuck == (expected if same_dt else expected | {7: Result.DT_INVALID, ROWS: Result.DT_INVALID})
