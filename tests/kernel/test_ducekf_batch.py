"""Whatever goes in, the batch of the DUCEKF gives the reference's numbers bit for bit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch.dhvpo import DhvpoBatch
from softplc.kernel.batch.ducekf import DucekfBatchState, DucekfBatchTuning, step
from softplc.kernel.batch.end_stops import EndStopsBatch
from softplc.kernel.reference.dhvpo import Dhvpo
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, DucekfTuning, ducekf
from softplc.kernel.reference.end_stops import EndStops
from softplc.kernel.result import Result

NUMBERS = ("x1", "x2", "K0", "K1", "S", "y_res", "s0", "s1", "wait", "y", "y_dot")
FLAGS = ("init", "armed", "touching", "impacts")
_CHOICES = ("covariance", "contact_from", "impact_scan", "edge")

_SPECIAL = [0.0, -0.0, 1e-300, -1.0, 1e30, 1e300, np.nan, np.inf, -np.inf]
_positions = st.one_of(st.floats(-0.1, 0.3), st.floats(-5.0, 5.0), st.sampled_from(_SPECIAL))
_variances = st.one_of(st.floats(0.0, 1.0), st.sampled_from([1e-4, *_SPECIAL, -0.5]))
_lengths = st.one_of(st.floats(0.0, 0.5), st.sampled_from([0.02]))
_models: st.SearchStrategy[Any] = st.one_of(
    st.builds(
        EndStops,
        kappa=st.sampled_from([0.0, 0.5, 0.9, 1.0, 1.5]),
        lower=st.sampled_from([0.0, -1.0, -math.inf]),
        upper=st.sampled_from([0.5, 2.0, math.inf]),
    ),
    st.builds(
        Dhvpo,
        alpha=st.floats(0.1, 3.0),
        mu=st.floats(0.5, 2.0),
        rho=st.floats(0.5, 2.0),
        kappa=st.sampled_from([0.5, 1.0, 1.5]),
    ),
)
_tunings = st.builds(
    DucekfTuning,
    q_x=_variances,
    q_x_dot=_variances,
    r_x=_variances,
    band=_lengths,
    hysteresis=_lengths,
    threshold=st.sampled_from([0.5, 0.0]),
    hold_limit=st.sampled_from([0.0, 0.1, 0.5, math.inf]),
    p_x=st.sampled_from([1.0, 0.2]),
    p_x_dot=st.sampled_from([10.0, 0.2]),
)
_scans = st.builds(
    DucekfInputs,
    EnableIn=st.sampled_from([True, True, True, True, False]),
    x=_positions,
    dt=st.one_of(st.just(0.05), st.floats(0.001, 1.0), st.sampled_from(_SPECIAL)),
    contact=st.sampled_from([0.0, 0.0, 1.0, np.nan]),
)


@dataclass
class Row:
    model: Any
    tuning: DucekfTuning
    scans: list[DucekfInputs]


def array(values: Sequence[Any], name: str) -> Any:
    return [getattr(value, name) for value in values]


def batch_of(rows: Sequence[Row]) -> tuple[Any, DucekfBatchTuning]:
    models, tunings = [row.model for row in rows], [row.tuning for row in rows]
    fields = ("kappa", "lower", "upper") if isinstance(models[0], EndStops) else ("alpha", "mu", "rho", "kappa")
    make: Any = EndStopsBatch if isinstance(models[0], EndStops) else DhvpoBatch
    names = set(DucekfTuning.__dataclass_fields__) - set(_CHOICES)
    choices = {name: getattr(tunings[0], name) for name in _CHOICES}
    tuning = DucekfBatchTuning(**{name: array(tunings, name) for name in names}, **choices)
    return make(**{name: array(models, name) for name in fields}), tuning


def assert_equal(rows: Sequence[Row]) -> list[Result]:
    """Steps all rows in one batch, and each through the reference; a row without more scans is stepped no more."""
    model, tuning = batch_of(rows)
    batch, states = DucekfBatchState(len(rows)), [DucekfState() for _ in rows]
    seen = []
    for k in range(max(len(row.scans) for row in rows)):
        scans = [row.scans[min(k, len(row.scans) - 1)] for row in rows]
        stepped = np.array([k < len(row.scans) for row in rows])
        codes = step(
            batch,
            tuning,
            model,
            EnableIn=np.array(array(scans, "EnableIn")),
            x=np.array(array(scans, "x")),
            dt=np.array(array(scans, "dt")),
            rows=stepped,
            contact=np.array(array(scans, "contact")),
        )
        for n, row in enumerate(rows):
            if not stepped[n]:
                assert codes[n] == Result.SKIPPED
            else:
                states[n], result = ducekf(row.model, row.tuning, states[n], scans[n])
                assert (k, n, Result(codes[n])) == (k, n, result)
                seen.append(result)
            state = states[n]
            for name in NUMBERS:
                got, expected = getattr(batch, name)[n], getattr(state, name)
                assert got == expected or (math.isnan(got) and math.isnan(expected)), (k, n, name, got, expected)
            for name in FLAGS:
                assert getattr(batch, name)[n] == getattr(state, name), (k, n, name)
            P00, P01, _, P11 = state.P
            for name, expected in (("P00", P00), ("P01", P01), ("P11", P11)):
                got = getattr(batch, name)[n]
                assert got == expected or (math.isnan(got) and math.isnan(expected)), (k, n, name, got, expected)
    return seen


@pytest.mark.parametrize("impact_scan", ["replace", "within"])
@pytest.mark.parametrize("contact_from", ["tag", "position", "either"])
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_batch_equals_reference_for_any_inputs(impact_scan: str, contact_from: str, data: st.DataObject):
    first = data.draw(_models)
    same = _models.filter(lambda model: type(model) is type(first))
    choices: Any = {
        "impact_scan": impact_scan,
        "contact_from": contact_from,
        "covariance": data.draw(st.sampled_from(["omega", "saltation", "none"])),
        "edge": data.draw(st.sampled_from(["above", "below"])),
    }
    rows = [
        Row(model, replace(data.draw(_tunings), **choices), data.draw(st.lists(_scans, min_size=1, max_size=12)))
        for model in [first, *data.draw(st.lists(same, max_size=3))]
    ]
    assert_equal(rows)


def bouncing(seed: int, n: int) -> list[DucekfInputs]:
    """A noisy ball between 0 and 2 that may turn on its own; uneven scans; a contact tag that is not always known."""
    rng = np.random.default_rng(seed)
    x, v, scans = 1.0, -float(rng.uniform(0.5, 3.0)), []
    for _ in range(n):
        dt = float(rng.uniform(0.01, 0.1))
        x, touched = x + v * dt, 0.0
        if not 0.0 < x < 2.0:
            x, v, touched = (-0.9 * x if x <= 0.0 else 2.0 - 0.9 * (x - 2.0)), -0.9 * v, 1.0
        if rng.random() < 0.02:
            v = -v
        contact = touched if rng.random() < 0.95 else math.nan
        scans.append(DucekfInputs(bool(rng.random() < 0.99), x + float(rng.normal()) * 0.01, dt, contact))
    return scans


@pytest.mark.parametrize("contact_from", ["tag", "position", "either"])
@pytest.mark.parametrize("covariance", ["omega", "saltation", "none"])
def test_batch_equals_reference_through_impacts_and_holds(contact_from: Any, covariance: Any):
    tuning = DucekfTuning(
        1e-6,
        1e-3,
        1e-4,
        0.03,
        covariance,
        contact_from,
        "within",
        hysteresis=0.03,
        hold_limit=0.3,
    )
    model = EndStops(0.9, 0.0, 2.0)
    seen = assert_equal([Row(model, tuning, bouncing(seed, 400)) for seed in range(12)])
    assert {Result.UPDATED, Result.IMPACT, Result.HELD, Result.INITIALISED, Result.DISABLED} <= set(seen)


def test_batch_equals_reference_on_oscillators_that_replace_the_step():
    rng, rows = np.random.default_rng(3), []
    for kappa, r_x in ((0.5, 1e-4), (0.8, 1e-2), (1.5, 1.0), (0.5, 10.0)):
        model = Dhvpo(kappa=kappa)
        x, before, scans = (0.0, 1.5), math.nan, []
        for _ in range(700):
            touched = 0.0 < x[0] <= 0.02 and x[0] < before
            before = x[0]
            x = (x[0], -kappa * x[1]) if touched else model.f(*x, 0.01)
            contact = float(touched) if rng.random() < 0.99 else math.nan
            scans.append(DucekfInputs(True, x[0] + float(rng.normal()) * 0.003, 0.01, contact))
        faster = replace(model, mu=1.2)  # its estimate is at the surface first
        rows.append(Row(faster, DucekfTuning(1e-4, 1e-4, r_x, 0.02, hold_limit=0.1), scans))
    assert {Result.IMPACT, Result.HELD} <= set(assert_equal(rows))


def test_a_cleared_row_starts_anew_and_keeps_its_count_of_impacts():
    tuning = DucekfTuning(1e-6, 1e-3, 1e-4, 0.03, "saltation", "tag", "within")
    model, batch_tuning = batch_of([Row(EndStops(0.9, 0.0, 2.0), tuning, [])] * 2)
    state, yes = DucekfBatchState(2), np.ones(2, bool)
    for scan in bouncing(1, 200):
        x, dt, contact = np.full(2, scan.x), np.full(2, scan.dt), np.full(2, scan.contact)
        step(state, batch_tuning, model, EnableIn=yes, x=x, dt=dt, rows=yes, contact=contact)
    count, kept = int(state.impacts[0]), float(state.x1[0])
    state.clear(np.array([False, True]))

    assert count > 0
    assert state.impacts.tolist() == [count, count]
    assert (state.x1.tolist(), state.P11[1], state.init.tolist()) == ([kept, 0.0], 0.0, [True, False])
    assert np.isnan([state.s0[1], state.s1[1], state.wait[1]]).all()


def test_finite_tells_the_rows_whose_state_is_a_number():
    tuning = DucekfTuning(1e-6, 1e-3, 1e-4, 0.03, "saltation", "tag", "within")
    model, batch_tuning = batch_of([Row(EndStops(0.9, 0.0, 2.0), tuning, [])] * 3)
    state, yes = DucekfBatchState(3), np.ones(3, bool)
    x = np.array([1.0, np.nan, np.inf])
    step(state, batch_tuning, model, EnableIn=yes, x=x, dt=np.full(3, 0.1), rows=yes, contact=np.zeros(3))
    assert state.finite().tolist() == [True, False, False]
