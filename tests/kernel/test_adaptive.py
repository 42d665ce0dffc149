"""The adaptive observer: batch and reference agree bit for bit, and both with matrices and common sense."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.batch import adaptive as batch
from softplc.kernel.reference import adaptive_hypothesis as reference
from softplc.kernel.reference.adaptive import AdaptiveInputs, AdaptiveState, adaptive
from softplc.kernel.result import Result

OUTPUTS = ("y", "y_dot", "y_ddot", "y_res", "S", "K0", "K1", "P00", "P01", "P11", "hold", "cruise", "manoeuvre")
HYPOTHESIS = ("w", "x", "v", "a", "P00", "P01", "P02", "P11", "P12", "P22")
_SPECIAL = [0.0, -0.0, 1e-300, -1.0, 1e30, 1e160, -1e300, np.nan, np.inf, -np.inf]
_scans = st.builds(
    AdaptiveInputs,
    EnableIn=st.sampled_from([True, True, True, True, False]),
    x=st.one_of(st.floats(-30.0, 30.0), st.floats(-1e4, 1e4), st.sampled_from(_SPECIAL)),
    dt=st.one_of(st.just(0.05), st.floats(1e-4, 2.0), st.sampled_from(_SPECIAL)),
    r_x=st.one_of(st.floats(1e-3, 10.0), st.sampled_from([0.0, -1.0, 1e-18, 1e18, np.nan])),
    top_speed=st.one_of(st.floats(0.1, 100.0), st.sampled_from([0.0, 1e-9, 1e9])),
    top_acceleration=st.one_of(st.floats(0.1, 100.0), st.sampled_from([0.0, 1e-9, 1e9])),
    gate=st.sampled_from([3.0, 6.0, 1e6]),
)


def row_of(state: AdaptiveState) -> list[float]:
    """Everything about one axis, flat."""
    hypotheses = [[float(one.mode), *(float(getattr(one, name)) for name in HYPOTHESIS)] for one in state.hypotheses]
    flat = [value for one in hypotheses for value in one]
    return [*(float(getattr(state, name)) for name in OUTPUTS), *flat, float(state.init), float(state.rejections)]


def run_reference(inputs: list[AdaptiveInputs]) -> tuple[NDArray[np.float64], list[Result]]:
    state, rows, results = AdaptiveState(), [], []
    for scan in inputs:
        state, result = adaptive(state, scan)
        rows.append(row_of(state))
        results.append(result)
    return np.array(rows), results


def run_batch(sequences: list[list[AdaptiveInputs]]) -> tuple[list[NDArray[np.float64]], list[list[Result]]]:
    """Several sequences as rows of one batch; a row whose sequence has ended is stepped no more."""
    n = len(sequences)
    state = batch.AdaptiveBatchState(n)
    rows_out: list[list[NDArray[np.float64]]] = [[] for _ in range(n)]
    results: list[list[Result]] = [[] for _ in range(n)]
    for k in range(max(map(len, sequences))):
        scans = [one[min(k, len(one) - 1)] for one in sequences]
        rows = np.array([k < len(one) for one in sequences])
        names = ("r_x", "top_speed", "top_acceleration", "gate")
        codes = batch.step(
            state,
            batch.AdaptiveTuning(**{name: [getattr(scan, name) for scan in scans] for name in names}),
            EnableIn=np.array([scan.EnableIn for scan in scans]),
            x=np.array([scan.x for scan in scans]),
            dt=np.array([scan.dt for scan in scans]),
            rows=rows,
        )
        outputs = np.array([getattr(state, name) for name in OUTPUTS])
        hypotheses = np.concatenate([state.modes[None].astype(float), state.hypotheses]).transpose(1, 0, 2)
        flat = hypotheses.reshape(-1, n)
        after = np.concatenate([outputs, flat, state.init[None].astype(float), state.rejections[None].astype(float)])
        for row in range(n):
            if rows[row]:
                rows_out[row].append(after[:, row])
                results[row].append(Result(codes[row]))
            else:
                assert codes[row] == Result.SKIPPED
                np.testing.assert_array_equal(after[:, row], rows_out[row][-1])
    return [np.array(one) for one in rows_out], results


@settings(max_examples=150, deadline=None)
@given(sequences=st.lists(st.lists(_scans, min_size=1, max_size=12), min_size=1, max_size=5))
def test_batch_equals_reference_for_any_inputs_enables_and_time_steps(sequences: list[list[AdaptiveInputs]]):
    batched, results = run_batch(sequences)

    for inputs, outputs, codes in zip(sequences, batched, results, strict=True):
        expected, expected_codes = run_reference(inputs)
        np.testing.assert_array_equal(outputs, expected)  # NaN equals NaN; everything else is ==
        assert codes == expected_codes


def machine(scans: int, seed: int = 3, **more: float) -> list[AdaptiveInputs]:
    """A ramp of 40 u/s for half of the scans, then rest, with U(−2, 2) and a jittering time step."""
    random = np.random.default_rng(seed)
    dt = random.uniform(0.03, 0.07, scans)
    t = np.cumsum(dt)
    x = 40.0 * np.minimum(t, t[scans // 2]) + random.uniform(-2.0, 2.0, scans)
    tuning = {"r_x": 4 / 3, "top_speed": 40.0, "top_acceleration": 80.0, **more}
    return [AdaptiveInputs(True, *pair, **tuning) for pair in zip(x.tolist(), dt.tolist(), strict=True)]


def test_two_hundred_axes_with_their_own_tuning_equal_two_hundred_references():
    random = np.random.default_rng(5)
    sequences = [
        machine(60, seed, r_x=r, top_speed=v, top_acceleration=a)
        for seed, (r, v, a) in enumerate(10.0 ** random.uniform((-2, 0, 0), (1, 2, 3), (200, 3)))
    ]

    batched, _ = run_batch(sequences)

    for inputs, outputs in zip(sequences[::23], batched[::23], strict=True):
        np.testing.assert_array_equal(outputs, run_reference(inputs)[0])


@pytest.mark.filterwarnings("error")
def test_no_warning_of_numpy_gets_out():
    inputs = [
        AdaptiveInputs(True, x, dt, r_x, 0.0, 0.0)
        for x in (1e300, -1e300, np.inf, np.nan)
        for dt in (1e-300, 1e300, np.inf)
        for r_x in (0.0, -1.0, 1e300)
    ]
    run_reference(inputs)
    run_batch([inputs])


def as_matrix(one: reference.Hypothesis) -> NDArray[np.float64]:
    return np.array(
        [[one.P00, one.P01, one.P02], [one.P01, one.P11, one.P12], [one.P02, one.P12, one.P22]], dtype=float
    )


@settings(max_examples=60, deadline=None)
@given(
    steps=st.lists(st.tuples(st.floats(-50, 50), st.floats(0.001, 1.0)), min_size=2, max_size=40),
    r_x=st.floats(1e-3, 10.0),
)
def test_probabilities_sum_to_one_and_every_covariance_is_one(steps: list[tuple[float, float]], r_x: float):
    state = AdaptiveState()
    for x, dt in steps:
        state, _ = adaptive(state, AdaptiveInputs(True, x, dt, r_x, 40.0, 80.0))

        # 1e-12: rounding of a dozen numbers below 1
        assert sum(one.w for one in state.hypotheses) == pytest.approx(1.0, abs=1e-12)
        assert state.hold + state.cruise + state.manoeuvre == pytest.approx(1.0, abs=1e-12)
        assert min(state.hold, state.cruise, state.manoeuvre) >= 0.0
        assert 0.0 <= state.K0 <= 1.0
        for one in state.hypotheses:
            P = as_matrix(one)
            scale = np.sqrt(np.maximum(np.diag(P), 1e-30))
            # of the correlation matrix, whose entries are of order 1: rounding alone may be below 0
            assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-6
        assert state.P00 >= 0.0
        assert state.P11 >= 0.0
        assert state.P01 * state.P01 <= state.P00 * state.P11 * (1 + 1e-9) + 1e-12


def test_hypotheses_predict_update_and_mix_as_the_textbook_s_matrices_do():
    inputs = machine(80)
    state = AdaptiveState()
    for scan in inputs:
        before = state
        state, result = adaptive(state, scan)
        if result is Result.UPDATED:
            expected = textbook(before, scan)
            got = [state.y, state.y_dot, state.y_ddot, state.P00, state.P01, state.P11, state.hold, state.S]
            assert got == pytest.approx(expected, rel=1e-8, abs=1e-9)  # rounding, in another order


def textbook(before: AdaptiveState, scan: AdaptiveInputs) -> list[float]:
    """One scan in matrices: Markov chain, mixed births, Kalman filters, swings and the eight most probable, mean."""
    dt, R, V, A = scan.dt, scan.r_x, scan.top_speed, scan.top_acceleration
    tau = V / A
    u, g, J = dt / (reference.CHANGE * tau), dt / (reference.DWELL * tau), reference.JUMP
    begin, end = dt / tau * reference.SWING_BEGINS, dt / tau * reference.SWING_ENDS
    leave = g * np.array([reference.TO_REST, 0, reference.TO_OTHER, reference.TO_CRUISE])
    rates = np.array(  # to rest, another speed, acceleration, constant speed, swing
        [
            [0, J * u, u, 0, begin],
            [J * u, J * u, u, 0, begin],
            [*leave, begin],
            [end / 4, end / 4, end / 4, end / 4, 0],
        ]
    )
    on = 1 / (1 + rates.sum(axis=1))
    old = before.hypotheses
    mode = np.array([one.mode for one in old])
    w = np.array([one.w for one in old])
    m = np.array([[one.x, one.v, one.a] for one in old])
    P = np.array([as_matrix(one) for one in old])

    swings = reference.SWINGS
    after_change = w * on[mode]
    after_change[:swings] += (w * on[mode] * rates[mode, 4]).sum() / swings
    modes, weights, means, covariances = list(mode), list(after_change), list(m), list(P)
    priors = [(0, 0, 0), (1, V * V, 0), (2, None, A * A), (1, None, 0)]
    for birth, (kind, speed, push) in enumerate(priors):
        share = w * on[mode] * rates[mode, birth]
        total = share.sum()
        share = share / total if total > 0 else share
        mean = share @ m
        d = m - mean
        P_mixed = np.einsum("i,ijk->jk", share, P + np.einsum("ij,ik->ijk", d, d))
        mean[2], P_mixed[2, :], P_mixed[:, 2] = 0, 0, 0
        P_mixed[2, 2] = push
        if speed is not None:
            mean[1], P_mixed[1, :2], P_mixed[:2, 1] = 0, 0, 0
            P_mixed[1, 1] = speed
        modes.append(kind)
        weights.append(total)
        means.append(mean)
        covariances.append(P_mixed)

    F = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
    density = {
        0: reference.CREEP * R / tau,
        1: reference.SWAY * A * A * tau,
        2: reference.JERK * A * A / tau,
    }
    drifts = [drift * A * A / tau for drift in reference.SWING_JERK]
    drifts += [density[kind] for kind in modes[swings:]]
    kept = []
    for kind, drift, weight, mean, covariance in zip(modes, drifts, weights, means, covariances, strict=True):
        nodes, gauss = np.polynomial.legendre.leggauss(4)  # exact for the polynomials of white noise
        Q = np.zeros((3, 3))
        for node, share in zip((nodes + 1) / 2 * dt, gauss / 2 * dt, strict=True):
            column = {0: [1, 0, 0], 1: [node, 1, 0]}.get(kind, [node * node / 2, node, 1])
            Q += share * drift * np.outer(column, column)
        ahead, P_ahead = F @ mean, F @ covariance @ F.T + Q
        nu, S = scan.x - ahead[0], P_ahead[0, 0] + R
        like = (1 + nu * nu / S / 64) ** -32 / np.sqrt(S)
        K = P_ahead[:, 0] / S
        after = (np.eye(3) - np.outer(K, [1, 0, 0])) @ P_ahead
        kept.append((weight * like, kind, ahead + K * nu, after, weight, ahead[0], S))
    expected_x = sum(one[4] * one[5] for one in kept)
    expected_S = sum(one[4] * (one[6] + (one[5] - expected_x) ** 2) for one in kept)
    others = sorted(kept[swings:], key=lambda one: -one[0])
    kept = kept[:swings] + others[: reference.HYPOTHESES]
    w = np.array([one[0] for one in kept])
    w = w / w.sum()
    m = np.array([one[2] for one in kept])
    mean = w @ m
    d = m - mean
    P_all = np.einsum("i,ijk->jk", w, np.array([one[3] for one in kept]) + np.einsum("ij,ik->ijk", d, d))
    hold = sum(share for share, one in zip(w, kept, strict=True) if one[1] == reference.HOLD)
    return [*mean, P_all[0, 0], P_all[0, 1], P_all[1, 1], hold, expected_S]


def test_the_likelihood_is_a_gauss_curve_where_it_matters():
    u = np.linspace(0.0, 9.0, 50)  # up to three standard deviations
    # the price of computing it without an exponential: it decides between hypotheses, so a factor of 1.4 is little
    assert (1 + u / 64) ** -32 / np.exp(-u / 2) == pytest.approx(1.0, abs=0.8)
    assert ((1 + u / 64) ** -32)[u <= 4] / np.exp(-u / 2)[u <= 4] == pytest.approx(1.0, abs=0.15)


def test_after_a_stop_the_velocity_is_zero_and_the_axis_is_known_to_hold():
    states = []
    state = AdaptiveState()
    for scan in machine(400):
        state, _ = adaptive(state, scan)
        states.append(state)

    assert np.mean([one.cruise for one in states[50:200]]) > 0.8
    assert np.mean([one.hold for one in states[250:]]) > 0.8
    velocity = np.array([one.y_dot for one in states[250:]])
    # the AOI tuned for this track has a standard deviation of 5 u/s there
    assert np.sqrt(np.mean(velocity * velocity)) < 1.5
    assert abs(np.mean(velocity)) < 0.2


@pytest.mark.parametrize("wild", [1e3, -1e9, 1e100, -1e300, np.inf, -np.inf, np.nan])
def test_up_to_three_wild_samples_are_left_out_and_leave_no_trace_of_their_size(wild: float):
    inputs = machine(120)
    for count in (1, 2, 3):
        scans = list(inputs)
        for k in range(100, 100 + count):
            scans[k] = AdaptiveInputs(True, wild, scans[k].dt, 4 / 3, 40.0, 80.0)
        outputs, results = run_reference(scans)
        assert results[100 : 100 + count] == [Result.REJECTED] * count
        assert results[100 + count] is Result.UPDATED
        assert np.isfinite(outputs[:, 0]).all()
        assert np.isfinite(outputs[:, 13:]).all()
        assert abs(outputs[110, 0] - inputs[110].x) < 4.0  # noise ±2, and ±2 for an estimate within it


def test_the_fourth_sample_far_away_is_believed():
    inputs = machine(140)
    scans = [*inputs[:100], *(AdaptiveInputs(True, one.x + 1e6, one.dt, 4 / 3, 40.0, 80.0) for one in inputs[100:])]

    outputs, results = run_reference(scans)

    assert results[100:104] == [Result.REJECTED] * 3 + [Result.INITIALISED]
    assert results[104:] == [Result.UPDATED] * 36
    assert abs(outputs[-1, 0] - scans[-1].x) < 4.0


def test_a_sample_of_0_far_from_the_axis_is_left_out_even_when_nothing_manoeuvres():
    """A birth without a parent has no state, so nothing may be near to it."""
    one = reference.Hypothesis(reference.HOLD, np.float64(1.0), np.float64(5000.0), P00=np.float64(0.1))
    spare = reference.Hypothesis(reference.HOLD, np.float64(0.0), np.float64(5000.0), P00=np.float64(0.1))
    state = AdaptiveState(
        init=True, hypotheses=(*[spare] * reference.SWINGS, one, *[spare] * (reference.HYPOTHESES - 1))
    )

    after, result = adaptive(state, AdaptiveInputs(True, 0.0, 0.05, 4 / 3, 40.0, 80.0))

    assert (result, after.y) == (Result.REJECTED, 5000.0)


def test_a_gentle_swing_that_lags_behind_opens_no_gate():
    """A swing may be far from an axis that has jumped; a sample at its place is as wild as any other."""
    near = {"x": np.float64(5000.0), "P00": np.float64(0.1)}
    hold = reference.Hypothesis(reference.HOLD, np.float64(0.9), **near)
    push = reference.Hypothesis(reference.MANOEUVRE, np.float64(0.1), **near)
    swing = reference.Hypothesis(reference.SWING, np.float64(1e-9), np.float64(4000.0), P00=np.float64(0.1))
    spare = reference.Hypothesis(reference.HOLD, np.float64(0.0), **near)
    others = (hold, push, *[spare] * (reference.HYPOTHESES - 2))
    state = AdaptiveState(init=True, hypotheses=(*[swing] * reference.SWINGS, *others))

    after, result = adaptive(state, AdaptiveInputs(True, 4000.0, 0.05, 4 / 3, 40.0, 80.0))

    assert result is Result.REJECTED
    assert after.y == pytest.approx(5000.0, abs=1e-4)  # 4e-9 of probability, 1000 u away


def test_a_motion_that_never_rests_is_found_to_swing_and_its_stop_is_seen():
    """±30 u in 15 s for two periods by a machine that can just do it, then rest; noise U(−2, 2)."""
    omega, random = 2 * np.pi / 15.0, np.random.default_rng(8)
    t = np.arange(900) * 0.05
    truth = 30.0 * np.sin(omega * np.minimum(t, 30.0 + 3.75))  # it stops at the end of its way
    swings, holds, velocities = [], [], []
    state = AdaptiveState()
    for z in truth + random.uniform(-2.0, 2.0, len(t)):
        state, _ = adaptive(state, AdaptiveInputs(True, z, 0.05, 4 / 3, 30 * omega, 30 * omega * omega))
        swings.append(sum(one.w for one in state.hypotheses[: reference.SWINGS]))
        holds.append(state.hold)
        velocities.append(state.y_dot)

    assert np.mean(swings[100:600]) > 0.9
    assert np.mean(holds[800:]) > 0.5
    assert np.sqrt(np.mean(np.square(velocities[800:]))) < 0.5  # u/s, of 12.6 at full speed


def test_what_is_no_number_never_starts_the_observer_anew():
    scans = [*machine(50), *[AdaptiveInputs(True, np.nan, 0.05, 4 / 3, 40.0, 80.0)] * 10]

    outputs, results = run_reference(scans)

    assert results[50:] == [Result.REJECTED] * 10
    assert np.isfinite(outputs[-1, :2]).all()


@pytest.mark.parametrize(("length", "seconds"), [(1024.0, 1.0), (1.0, 0.125), (2.0**-20, 8.0)])
def test_another_unit_of_length_or_time_changes_the_unit_and_nothing_else(length: float, seconds: float):
    """Powers of two scale without rounding, so the numbers are the same to the last bit."""
    one, _ = run_reference(machine(150))
    scaled = [
        AdaptiveInputs(
            True,
            scan.x * length,
            scan.dt * seconds,
            scan.r_x * length * length,
            scan.top_speed * length / seconds,
            scan.top_acceleration * length / seconds / seconds,
        )
        for scan in machine(150)
    ]

    other, _ = run_reference(scaled)

    assert (other[:, OUTPUTS.index("y")] == one[:, OUTPUTS.index("y")] * length).all()
    assert (other[:, OUTPUTS.index("y_dot")] == one[:, OUTPUTS.index("y_dot")] * length / seconds).all()
    assert (other[:, OUTPUTS.index("P11")] == one[:, OUTPUTS.index("P11")] * (length / seconds) ** 2).all()
    for name in ("K0", "hold", "cruise", "manoeuvre"):
        assert (other[:, OUTPUTS.index(name)] == one[:, OUTPUTS.index(name)]).all()


@pytest.mark.parametrize("dt", [0.0, -0.0, -0.1, -np.inf, np.nan])
def test_where_no_time_has_passed_the_sample_passes_through_and_the_state_stays(dt: float):
    inputs = machine(60)
    outputs, results = run_reference([*inputs, AdaptiveInputs(True, 99.0, dt, 4 / 3, 40.0, 80.0)])

    assert results[-1] is Result.DT_INVALID
    assert outputs[-1, :3].tolist() == [99.0, 0.0, 0.0]
    assert outputs[-1, 3:].tolist() == outputs[-2, 3:].tolist()


def test_disabled_passes_through_and_the_next_enabled_scan_starts_at_the_measurement_at_rest():
    inputs = machine(60)
    state = AdaptiveState()
    for scan in inputs:
        state, _ = adaptive(state, scan)

    off, result = adaptive(state, AdaptiveInputs(False, 7.0, 0.05, 4 / 3, 40.0, 80.0))
    again, started = adaptive(off, AdaptiveInputs(True, 3.0, 0.05, 4 / 3, 40.0, 80.0))

    assert (result, off.y, off.y_dot, off.init) == (Result.DISABLED, 7.0, 0.0, False)
    assert (started, again.y, again.y_dot, again.init) == (Result.INITIALISED, 3.0, 0.0, True)
    assert again == adaptive(AdaptiveState(), AdaptiveInputs(True, 3.0, 0.05, 4 / 3, 40.0, 80.0))[0]


def test_cleared_rows_are_as_before_the_first_scan_and_finite_tells_which_are_not():
    _, _ = run_batch([machine(5)])
    state, fresh = batch.AdaptiveBatchState(3), batch.AdaptiveBatchState(3)
    tuning = batch.AdaptiveTuning(r_x=[1.0] * 3, top_speed=[10.0] * 3, top_acceleration=[10.0] * 3, gate=[6.0] * 3)
    every = np.full(3, True)
    for k in range(4):
        batch.step(state, tuning, EnableIn=every, x=np.full(3, 0.1 * k), dt=np.full(3, 0.05), rows=every)
    state.hypotheses[3, 2, 1] = np.nan

    assert state.finite().tolist() == [True, False, True]
    assert len(state) == 3
    state.clear(every)
    for name in ("init", "rejections", "modes", "hypotheses", "y", "y_dot", "S", "hold"):
        np.testing.assert_array_equal(getattr(state, name), getattr(fresh, name))
