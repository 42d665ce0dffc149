"""Coasting: steps and coasts in any order, batch and reference bit for bit; and P grows as a prediction's does."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch import adaptive, alpha_beta, aoi, cv_accel, ducekf, fb_kalman
from softplc.kernel.batch import coast as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.batch.dhvpo import DhvpoBatch
from softplc.kernel.batch.end_stops import EndStopsBatch
from softplc.kernel.reference import coast as reference
from softplc.kernel.reference.adaptive import AdaptiveInputs, AdaptiveState
from softplc.kernel.reference.adaptive import adaptive as adaptive_reference
from softplc.kernel.reference.alpha_beta import AlphaBetaInputs, AlphaBetaState, alpha_beta_lreal, alpha_beta_real
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real
from softplc.kernel.reference.aoi_options import AoiOptionsState, aoi_options_lreal, aoi_options_real
from softplc.kernel.reference.cv_accel import CvAccelInputs, CvAccelState
from softplc.kernel.reference.cv_accel import cv_accel as cv_accel_reference
from softplc.kernel.reference.dhvpo import Dhvpo
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, DucekfTuning
from softplc.kernel.reference.ducekf import ducekf as ducekf_reference
from softplc.kernel.reference.end_stops import EndStops
from softplc.kernel.reference.fb_kalman import FbKalmanInputs, FbKalmanState
from tests.kernel.fb_kalman_sequences import CALLS
from tests.kernel.test_aoi_options_batch import any_options

_SPECIAL = [0.0, -0.0, 1e-300, -1.0, 1e30, np.nan, np.inf]
_x = st.one_of(st.floats(-5.0, 5.0), st.sampled_from([1e300, -np.inf, np.nan]))
_dt = st.one_of(st.just(0.05), st.floats(1e-3, 1.0), st.sampled_from(_SPECIAL))
_q = st.one_of(st.floats(0.0, 10.0), st.sampled_from([1e30, -0.5, np.nan]))
_r = st.one_of(st.floats(1e-3, 10.0), st.sampled_from([0.0, -1.0, 1e30]))
_scan = st.tuples(
    st.sampled_from(["step", "step", "step", "coast", "coast", "skip"]),
    st.sampled_from([True, True, True, True, True, False]),
    _x,
    _dt,
)


@dataclass
class Row:
    """One axis: its tuning (whatever its kind needs), and what happens scan by scan: (what, EnableIn, x, dt)."""

    tuned: Any
    scans: Sequence[tuple[str, bool, float, float]]


@dataclass
class Kind:
    """One observer: how to draw a tuning, and how its scalar and its batch form step and coast."""

    tuned: st.SearchStrategy[Any]
    start: Callable[[], Any]
    step: Callable[[Any, Any, bool, float, float], Any]
    coast: Callable[[Any, Any, float], Any]
    batch: Callable[[Sequence[Any]], tuple[Any, Callable[..., Any], Callable[..., Any]]]
    names: dict[str, str]  # of the batch's array → of the reference's number


def _fields(state: type, **renamed: str) -> dict[str, str]:
    return {renamed.get(field.name, field.name): field.name for field in dataclasses.fields(state)}


def _aoi(real: Any) -> Kind:
    call = aoi_real if real is np.float32 else aoi_lreal

    def given_(tuned: Any, enable: bool, x: float, dt: float) -> AoiInputs:
        return AoiInputs(enable, x, 1000.0 * dt, *tuned)

    def many(tuned: Sequence[Any]) -> Any:
        state = aoi.AoiBatchState(len(tuned), real)
        tuning = _aoi_tuning(real, tuned)
        return (
            state,
            lambda enable, x, dt, rows: aoi.step(state, tuning, EnableIn=enable, x=x, dt=1000.0 * dt, rows=rows),
            lambda dt, rows: batch.aoi_coast(state, tuning, 1000.0 * dt, rows),
        )

    names = {name: name for name in ("init", "dt_s", "x_pred", "x_dot_pred", "K0", "K1", "S", "y_res", "y", "y_dot")}
    return Kind(
        _AOI_TUNED,
        AoiState,
        lambda state, tuned, enable, x, dt: call(state, given_(tuned, enable, x, dt))[0],
        lambda state, tuned, dt: reference.aoi_coast(state, given_(tuned, True, 0.0, dt), real),
        many,
        {**names, **{f"P{i}": f"P.{i}" for i in range(4)}},
    )


_AOI_TUNED = st.tuples(_q, _q, _r, st.booleans(), st.floats(0.0, 1.0), st.floats(0.0, 1.0))


def _aoi_tuning(real: Any, tuned: Sequence[Any], options: Any = None) -> aoi.AoiTuning:
    names = ("q_x", "q_x_dot", "r_x", "BleedEnable", "BleedThresh", "BleedFactor")
    return aoi.AoiTuning(real, **{name: [one[k] for one in tuned] for k, name in enumerate(names)}, options=options)


def _aoi_options(real: Any) -> Kind:
    call = aoi_options_real if real is np.float32 else aoi_options_lreal

    def given_(tuned: Any, enable: bool, x: float, dt: float) -> AoiInputs:
        return AoiInputs(enable, x, 1000.0 * dt, *tuned[0])

    def many(tuned: Sequence[Any]) -> Any:
        state = aoi.AoiBatchState(len(tuned), real)
        tuning = _aoi_tuning(real, [one for one, _ in tuned], AoiBatchOptions(real, [two for _, two in tuned]))
        return (
            state,
            lambda enable, x, dt, rows: aoi.step(state, tuning, EnableIn=enable, x=x, dt=1000.0 * dt, rows=rows),
            lambda dt, rows: batch.aoi_coast(state, tuning, 1000.0 * dt, rows),
        )

    inner = {
        f"aoi.{name}": name
        for name in ("init", "dt_s", "x_pred", "x_dot_pred", "K0", "K1", "S", "y_res", "y", "y_dot")
    }
    return Kind(
        st.tuples(_AOI_TUNED, any_options),
        AoiOptionsState,
        lambda state, tuned, enable, x, dt: call(state, given_(tuned, enable, x, dt), tuned[1])[0],
        lambda state, tuned, dt: reference.aoi_options_coast(state, given_(tuned, True, 0.0, dt), tuned[1], real),
        many,
        {
            **{batch_name: name for name, batch_name in inner.items()},
            **{f"P{i}": f"aoi.P.{i}" for i in range(4)},
            **{name: name for name in ("offset", "in_a_row", "rejected")},
        },
    )


def _fb_kalman(real: Any, variant: Any) -> Kind:
    call = CALLS[variant, "real" if real is np.float32 else "lreal"]

    def given_(tuned: Any, enable: bool, x: float, dt: float) -> FbKalmanInputs:
        return FbKalmanInputs(x, *tuned, dt, EnableIn=enable)

    def many(tuned: Sequence[Any]) -> Any:
        state = fb_kalman.FbKalmanBatchState(len(tuned), real)
        tuning = fb_kalman.FbKalmanTuning(
            real, Q=[one[0] for one in tuned], R=[one[1] for one in tuned], variant=variant
        )
        return (
            state,
            lambda enable, x, dt, rows: fb_kalman.step(state, tuning, EnableIn=enable, x=x, dt=dt, rows=rows),
            lambda dt, rows: batch.fb_kalman_coast(state, tuning, dt, rows),
        )

    return Kind(
        st.tuples(_q, _r),
        FbKalmanState,
        lambda state, tuned, enable, x, dt: call(state, given_(tuned, enable, x, dt))[0],
        lambda state, tuned, dt: reference.fb_kalman_coast(state, given_(tuned, True, 0.0, dt), real),
        many,
        _fields(FbKalmanState, EstimatedPosition="y", EstimatedVelocity="y_dot"),
    )


def _cv_accel() -> Kind:
    names = ("r_x", "q_x", "q_x_dot", "q_x_ddot", "white_jerk", "q_jerk")

    def many(tuned: Sequence[Any]) -> Any:
        state = cv_accel.CvAccelBatchState(len(tuned))
        tuning = cv_accel.CvAccelTuning(**{name: [one[k] for one in tuned] for k, name in enumerate(names)})
        return (
            state,
            lambda enable, x, dt, rows: cv_accel.step(state, tuning, EnableIn=enable, x=x, dt=dt, rows=rows),
            lambda dt, rows: batch.cv_accel_coast(state, tuning, dt, rows),
        )

    return Kind(
        st.tuples(_r, _q, _q, _q, st.booleans(), _q),
        CvAccelState,
        lambda state, tuned, enable, x, dt: cv_accel_reference(state, CvAccelInputs(enable, x, dt, *tuned))[0],
        lambda state, tuned, dt: reference.cv_accel_coast(state, CvAccelInputs(True, 0.0, dt, *tuned)),
        many,
        _fields(CvAccelState),
    )


def _alpha_beta(real: Any) -> Kind:
    call = alpha_beta_real if real is np.float32 else alpha_beta_lreal
    names = ("indexed", "alpha", "beta", "sigma_w", "sigma_v")

    def many(tuned: Sequence[Any]) -> Any:
        state = alpha_beta.AlphaBetaBatchState(len(tuned), real)
        tuning = alpha_beta.AlphaBetaTuning(real, **{name: [one[k] for one in tuned] for k, name in enumerate(names)})
        return (
            state,
            lambda enable, x, dt, rows: alpha_beta.step(state, tuning, EnableIn=enable, x=x, dt=dt, rows=rows),
            lambda dt, rows: batch.alpha_beta_coast(state, dt, rows),
        )

    positive = st.floats(1e-3, 1e3)
    return Kind(
        st.tuples(st.booleans(), st.floats(0.0, 1.0), st.floats(0.0, 4.0), positive, positive),
        AlphaBetaState,
        lambda state, tuned, enable, x, dt: call(state, AlphaBetaInputs(enable, x, dt, *tuned))[0],
        lambda state, tuned, dt: reference.alpha_beta_coast(state, AlphaBetaInputs(True, 0.0, dt, *tuned), real),
        many,
        _fields(AlphaBetaState),
    )


def _adaptive() -> Kind:
    names = ("r_x", "top_speed", "top_acceleration", "gate")

    def many(tuned: Sequence[Any]) -> Any:
        state = adaptive.AdaptiveBatchState(len(tuned))
        tuning = adaptive.AdaptiveTuning(**{name: [one[k] for one in tuned] for k, name in enumerate(names)})
        return (
            state,
            lambda enable, x, dt, rows: adaptive.step(state, tuning, EnableIn=enable, x=x, dt=dt, rows=rows),
            lambda dt, rows: batch.adaptive_coast(state, tuning, dt, rows),
        )

    own = ("w", "x", "v", "a", "P00", "P01", "P02", "P11", "P12", "P22")
    deep = {f"hypotheses.{k}.{i}": f"hypotheses.{i}.{name}" for k, name in enumerate(own) for i in range(12)}
    flat = _fields(AdaptiveState)
    del flat["hypotheses"]
    return Kind(
        st.tuples(st.floats(1e-3, 10.0), st.floats(0.1, 100.0), st.floats(0.1, 100.0), st.sampled_from([2.0, 4.0])),
        AdaptiveState,
        lambda state, tuned, enable, x, dt: adaptive_reference(state, AdaptiveInputs(enable, x, dt, *tuned))[0],
        lambda state, tuned, dt: reference.adaptive_coast(state, AdaptiveInputs(True, 0.0, dt, *tuned)),
        many,
        {**flat, **deep, **{f"modes.{i}": f"hypotheses.{i}.mode" for i in range(12)}},
    )


def _ducekf(models: st.SearchStrategy[Any], impact_scan: Any) -> Kind:
    fixed = {"covariance": "saltation", "contact_from": "position", "impact_scan": impact_scan}
    numbers = ("q_x", "q_x_dot", "r_x", "band", "hysteresis", "threshold", "hold_limit", "p_x", "p_x_dot")

    def many(tuned: Sequence[Any]) -> Any:
        state = ducekf.DucekfBatchState(len(tuned))
        tuning = ducekf.DucekfBatchTuning(
            **{name: [getattr(two, name) for _, two in tuned] for name in numbers},
            **fixed,  # type: ignore[arg-type]
        )
        first = tuned[0][0]
        make: Any = EndStopsBatch if isinstance(first, EndStops) else DhvpoBatch
        parts = [field.name for field in dataclasses.fields(first)]
        model = make(**{name: [getattr(one, name) for one, _ in tuned] for name in parts})

        def step(enable: Any, x: Any, dt: Any, rows: Any) -> None:
            nothing = np.full(len(tuned), np.nan)
            ducekf.step(state, tuning, model, EnableIn=enable, x=x, dt=dt, rows=rows, contact=nothing)

        return state, step, lambda dt, rows: batch.ducekf_coast(state, tuning, model, dt, rows)

    names = _fields(DucekfState)
    for name in ("P", "routes"):
        del names[name]
    length = st.floats(0.01, 0.3)
    return Kind(
        st.tuples(
            models,
            st.builds(
                DucekfTuning,
                q_x=_q,
                q_x_dot=_q,
                r_x=_r,
                band=length,
                hysteresis=length,
                **{name: st.just(value) for name, value in fixed.items()},
            ),
        ),
        DucekfState,
        lambda state, tuned, enable, x, dt: ducekf_reference(*tuned, state, DucekfInputs(enable, x, dt))[0],
        lambda state, tuned, dt: reference.ducekf_coast(*tuned, state, DucekfInputs(True, 0.0, dt)),
        many,
        {**names, "P00": "P.0", "P01": "P.1", "P11": "P.3"},
    )


_STOPS = st.builds(
    EndStops, kappa=st.sampled_from([0.0, 0.5, 1.5]), lower=st.sampled_from([-1.0, 0.0]), upper=st.just(2.0)
)
_OSCILLATORS = st.builds(
    Dhvpo, alpha=st.just(1.0), mu=st.floats(0.5, 2.0), rho=st.just(1.5), kappa=st.sampled_from([0.5, 1.0])
)
KINDS = {
    "aoi": _aoi(np.float64),
    "aoi in REAL": _aoi(np.float32),
    "aoi with options": _aoi_options(np.float64),
    "aoi with options in REAL": _aoi_options(np.float32),
    "fb_kalman as written": _fb_kalman(np.float64, "as_written"),
    "fb_kalman as written in REAL": _fb_kalman(np.float32, "as_written"),
    "fb_kalman corrected": _fb_kalman(np.float64, "corrected"),
    "fb_kalman corrected in REAL": _fb_kalman(np.float32, "corrected"),
    "cv_accel": _cv_accel(),
    "alpha_beta": _alpha_beta(np.float64),
    "alpha_beta in REAL": _alpha_beta(np.float32),
    "adaptive": _adaptive(),
    "ducekf between stops": _ducekf(_STOPS, "within"),
    "ducekf with the oscillator": _ducekf(_OSCILLATORS, "replace"),
}


def _of(value: Any, path: str) -> float:
    for part in path.split("."):
        value = value[int(part)] if part.isdigit() else getattr(value, part)
    return float(value)


def _in(state: Any, path: str, row: int) -> float:
    name, *index = path.split(".")
    value = getattr(state, name)
    for part in index:
        value = value[int(part)]
    return float(value[row])


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_steps_and_coasts_in_any_order_are_the_same_numbers_as_scalars_and_as_arrays(name: str, data: st.DataObject):
    kind = KINDS[name]
    scans = data.draw(st.integers(1, 12))
    each = st.builds(Row, kind.tuned, st.lists(_scan, min_size=scans, max_size=scans))
    rows = data.draw(st.lists(each, min_size=1, max_size=4))
    state, step, coast = kind.batch([row.tuned for row in rows])
    states = [kind.start() for _ in rows]

    for k in range(scans):
        what, enable, x, dt = (np.array(column) for column in zip(*(row.scans[k] for row in rows), strict=True))
        coast(dt, what == "coast")
        step(enable, x, dt, what == "step")
        for i, row in enumerate(rows):
            if what[i] == "coast":
                states[i] = kind.coast(states[i], row.tuned, dt[i])
            elif what[i] == "step":
                with np.errstate(all="ignore"):
                    states[i] = kind.step(states[i], row.tuned, bool(enable[i]), float(x[i]), float(dt[i]))
            for array, number in kind.names.items():
                got, expected = _in(state, array, i), _of(states[i], number)
                np.testing.assert_array_equal(got, expected, err_msg=f"scan {k}, row {i}, {array}")  # NaN is NaN


SANE: dict[str, Any] = {
    "aoi": (0.001, 0.1, 4 / 3, True, 10.0, 0.5),
    "fb_kalman as written": (0.1, 1.0),
    "fb_kalman corrected": (0.1, 1.0),
    "cv_accel": (1.0, 0.01, 0.1, 1.0, False, 0.0),
    "adaptive": (1.0, 50.0, 100.0, 4.0),
    "ducekf between stops": (EndStops(0.5, lower=-1e6, upper=1e6), DucekfTuning(0.001, 0.1, 1.0, 0.1)),
}


@pytest.mark.parametrize("name", SANE)
def test_the_variance_of_a_coasting_position_grows_with_every_scan(name: str):
    kind, tuned = KINDS[name], SANE[name]
    variance = next(kind.names[key] for key in ("P00", "P0", "p_11") if key in kind.names)
    state = kind.start()
    for k in range(200):
        state = kind.step(state, tuned, True, 10.0 * 0.05 * k, 0.05)
    before = [_of(state, variance)]
    for _ in range(40):
        state = kind.coast(state, tuned, 0.05)
        before.append(_of(state, variance))

    assert (np.diff(before) > 0.0).all()
    assert before[-1] > 4.0 * before[0]  # σ more than twice as wide after 2 s


def test_a_coasting_axis_waits_at_its_stop():
    stops, tuning = EndStops(0.5, lower=-1.0, upper=1.0), DucekfTuning(0.001, 0.1, 0.01, 0.05)
    state = DucekfState(init=True, x1=0.9, x2=10.0, P=(0.01, 0.0, 0.0, 0.1))
    for _ in range(3):
        state = reference.ducekf_coast(stops, tuning, state, DucekfInputs(True, 0.0, 0.05))
        assert (state.x1, state.y, state.x2) == (1.0, 1.0, 10.0)


def test_coasting_k_times_is_the_prediction_that_k_scans_without_a_measurement_would_make():
    """Against matrices: x̂⁻ = Fᵏx̂, P⁻ = F·P·Fᵀ + Q each time."""
    inputs = AoiInputs(True, 0.0, 50.0, 0.001, 0.1, 4 / 3)
    state = AoiState()
    for k in range(50):
        state = aoi_lreal(state, dataclasses.replace(inputs, x=0.5 * k))[0]
    x, P = np.array([state.x_pred, state.x_dot_pred]), np.array(state.P).reshape(2, 2)
    F, Q = np.array([[1.0, 0.05], [0.0, 1.0]]), np.diag([0.001, 0.1])
    for _ in range(10):
        state = reference.aoi_coast(state, inputs)
        x, P = F @ x, F @ P @ F.T + Q

    # Ten scans of the same sums in another order: rounding alone.
    assert np.array([state.x_pred, state.x_dot_pred]) == pytest.approx(x, rel=1e-13)
    assert np.array(state.P) == pytest.approx(P.ravel(), rel=1e-12)
    assert pytest.approx(P[0, 0] + 4 / 3, rel=1e-12) == state.S
