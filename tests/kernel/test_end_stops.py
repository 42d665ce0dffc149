"""An axis at its end stops: the filter follows every impact, waits for a late one, and knows a false one."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.kernel.reference.ducekf import ContactFrom, DucekfInputs, DucekfState, DucekfTuning, ducekf
from softplc.kernel.reference.end_stops import EndStops
from softplc.kernel.result import Result
from tests.kernel.bounce import Truth, bounce

SIGMA = 0.01
TUNING = DucekfTuning(
    q_x=1e-6,
    q_x_dot=1e-4,
    r_x=SIGMA * SIGMA,
    band=4 * SIGMA,
    covariance="saltation",
    impact_scan="within",
    hysteresis=4 * SIGMA,
    hold_limit=0.5,
)


@dataclass
class Run:
    states: list[DucekfState] = field(default_factory=list)
    results: list[Result] = field(default_factory=list)

    def at(self, result: Result) -> list[int]:
        return [k for k, one in enumerate(self.results) if one == result]

    @property
    def v(self) -> np.ndarray:
        return np.array([state.y_dot for state in self.states])

    @property
    def x(self) -> np.ndarray:
        return np.array([state.y for state in self.states])


def follow(
    truth: Truth, dt: float, model: EndStops, tuning: DucekfTuning = TUNING, *, sigma: float = SIGMA, seed: int = 0
) -> Run:
    """The filter on noisy samples; the tag closes for the scan after the impact, if there is a tag."""
    rng, run, state = np.random.default_rng(seed), Run(), DucekfState()
    for x, contact in zip(truth.x, truth.contact, strict=True):
        tag = math.nan if tuning.contact_from == "position" else float(contact)
        state, result = ducekf(model, tuning, state, DucekfInputs(True, x + sigma * float(rng.normal()), dt, tag))
        run.states.append(state)
        run.results.append(result)
    return run


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("kappa", [0.5, 0.9, 1.0])
def test_with_a_tag_every_impact_is_followed_in_its_scan_at_any_time_step(dt: float, kappa: float):
    truth = bounce(2000, dt, kappa=kappa, upper=3.0, x=2.5012)
    run = follow(truth, dt, EndStops(kappa, 0.0, 3.0), replace(TUNING, contact_from="tag"))

    assert run.at(Result.IMPACT) == truth.impacts
    assert run.states[-1].impacts == len(truth.impacts) >= 2
    assert run.at(Result.HELD) == []
    # ten samples into it the velocity is known; from then on no impact may throw it off: 6 standard deviations
    limits = [6 * math.sqrt(state.P[3]) for state in run.states]
    assert (abs(run.v - truth.v) < limits)[10:].all()


@pytest.mark.parametrize("dt", [0.02, 0.1, 0.3, 0.9])
@pytest.mark.parametrize("contact_from", ["position", "either"])
def test_without_a_tag_the_position_finds_every_impact_and_none_tunnels_through(dt: float, contact_from: ContactFrom):
    truth = bounce(600, dt, kappa=0.9, upper=3.0, x=2.5012)
    run = follow(truth, dt, EndStops(0.9, 0.0, 3.0), replace(TUNING, contact_from=contact_from))

    found = run.at(Result.IMPACT)
    assert len(found) == len(truth.impacts) > 2
    # the position tells it from the sample: a scan sooner or later where the impact falls near one
    assert all(abs(ours - true) <= 1 for ours, true in zip(found, truth.impacts, strict=True))
    assert np.median(abs(run.v - truth.v)[10:]) < 0.03


def test_a_band_of_the_paper_alone_would_miss_them():
    """|v|Δt = 0.3 against a band of 0.04: the carried position lies in it by chance only."""
    truth = bounce(100, 0.3, kappa=1.0, upper=3.0, x=1.0512)
    paper = replace(TUNING, contact_from="position", impact_scan="replace")
    missed = follow(truth, 0.3, EndStops(1.0, 0.0, 3.0), paper, sigma=0.0)
    assert len(missed.at(Result.IMPACT)) < len(truth.impacts) / 2

    found = follow(truth, 0.3, EndStops(1.0, 0.0, 3.0), replace(TUNING, contact_from="position"), sigma=0.0)
    assert found.at(Result.IMPACT) == truth.impacts


@pytest.mark.parametrize(("margin", "share"), [(0.014, 0.045), (0.020, 0.33)])
def test_share_of_impacts_that_a_band_of_002_misses_at_15_units_a_second(margin: float, share: float):
    """One sample every |v|Δt, the band 0.02 wide: the rest of the way is not seen. Closed form, 1 − 0.02/(|v|Δt)."""
    assert 1.0 - 0.02 / (1.5 * margin) == pytest.approx(share, abs=0.005)


def test_a_stop_without_rebound_takes_all_speed_at_once():
    truth = bounce(200, 0.01, kappa=0.0)
    run = follow(truth, 0.01, EndStops(0.0, 0.0), replace(TUNING, contact_from="tag"))

    hit = truth.impacts[0]
    assert run.at(Result.IMPACT) == [hit]
    before, after = run.states[hit - 1], run.states[hit]
    assert before.y_dot == pytest.approx(-1.0, abs=0.05)
    assert abs(after.y_dot) < 0.02
    assert after.P[3] < 2 * TUNING.q_x_dot  # the stop, not the samples, says that it stands: P11 is Q11
    assert abs(run.x[hit:]).max() < 4 * SIGMA


@pytest.mark.parametrize("impact_scan", ["within", "replace"])
def test_omega_at_kappa_0_is_undefined_and_saltation_takes_its_place(impact_scan: str):
    truth = bounce(200, 0.01, kappa=0.0)
    runs = [
        follow(truth, 0.01, EndStops(0.0, 0.0), replace(TUNING, covariance=covariance, impact_scan=impact_scan))
        for covariance in ("omega", "saltation")
    ]
    assert repr(runs[0].states) == repr(runs[1].states)  # NaN is in them, which equals nothing


def test_without_the_constraint_the_same_filter_needs_half_a_second_to_find_the_speed_again():
    truth = bounce(300, 0.01, kappa=0.8)
    hit = truth.impacts[0]
    blind = follow(replace(truth, contact=truth.contact & False), 0.01, EndStops(0.8, -1e6))
    aware = follow(truth, 0.01, EndStops(0.8, 0.0))

    def lost(run: Run) -> int:
        return int(np.count_nonzero(abs(run.v - truth.v)[hit:] > 0.2))

    assert lost(aware) == 0
    assert lost(blind) > 15


def test_an_estimate_that_is_early_is_held_until_the_contact():
    """The axis brakes before the stop; the filter, tuned stiff, does not believe it."""
    stiff, dt, state = replace(TUNING, q_x_dot=1e-10, r_x=1.0, hold_limit=10.0), 0.01, DucekfState()
    results, positions = [], []
    x, v = 2.0, -1.0
    for _ in range(290):
        v = -0.6 if x < 1.0 else v  # slower than it was
        x = max(x + v * dt, 0.0)
        state, result = ducekf(EndStops(0.5, 0.0), stiff, state, DucekfInputs(True, x, dt, float(x <= 0.0)))
        results.append(result)
        positions.append(state.y)

    held = [k for k, result in enumerate(results) if result == Result.HELD]
    assert len(held) > 3
    assert held == list(range(held[0], held[-1] + 1))
    assert len({positions[k] for k in held}) == 1
    assert results[held[-1] + 1] == Result.IMPACT


def hold(hold_limit: float, v_after: float) -> tuple[list[Result], list[DucekfState]]:
    """A stiff filter on its way to a stop, and an axis that goes on with another velocity 0.5 before it."""
    stiff, dt, state = replace(TUNING, q_x_dot=1e-10, r_x=1.0, hold_limit=hold_limit), 0.01, DucekfState()
    results, states, x = [], [], 3.0
    for _ in range(600):
        x = x - dt if x > 0.5 or not results else x + v_after * dt
        if x <= 0.5:
            x = 0.5 if v_after == 0.0 else x
        state, result = ducekf(EndStops(0.5, 0.0), stiff, state, DucekfInputs(True, x, dt, 0.0))
        results.append(result)
        states.append(state)
    return results, states


@pytest.mark.parametrize("hold_limit", [0.2, 100.0])
def test_a_contact_that_never_comes_ends_the_hold_with_a_new_start(hold_limit: float):
    """At the latest after hold_limit, or twice the time that the axis would need at the estimated speed."""
    results, states = hold(hold_limit, 0.0)

    held = results.count(Result.HELD)
    needed = 2.0 * 0.5 / abs(states[results.index(Result.HELD)].y_dot)
    assert held == pytest.approx(min(hold_limit, needed) / 0.01, abs=1.0)  # whole scans
    restart = results.index(Result.INITIALISED, 1)
    assert restart == results.index(Result.HELD) + held
    assert (states[restart].y, states[restart].y_dot) == (0.5, 0.0)
    assert set(results[restart + 1 :]) == {Result.UPDATED}
    assert states[-1].y == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("contact_from", ["tag", "position", "either"])
def test_an_axis_that_rests_on_its_stop_reports_one_impact_and_no_hold(contact_from: ContactFrom):
    truth = bounce(100, 0.01, kappa=0.0, x=0.5)
    resting = Truth(np.append(truth.x, np.zeros(3000)), np.append(truth.v, np.zeros(3000)), np.zeros(3100, bool))
    resting.contact[truth.impacts[0] :] = True  # a limit switch stays closed
    run = follow(resting, 0.01, EndStops(0.0, 0.0), replace(TUNING, contact_from=contact_from))

    assert len(run.at(Result.IMPACT)) == 1
    assert run.at(Result.HELD) == []
    assert run.states[-1].touching == (contact_from != "position" or run.states[-1].s1 <= TUNING.band)


def test_without_hysteresis_a_noisy_rest_would_report_more():
    truth = bounce(100, 0.01, kappa=0.0, x=0.5)
    resting = Truth(np.append(truth.x, np.zeros(5000)), np.append(truth.v, np.zeros(5000)), np.zeros(5100, bool))
    count = {
        hysteresis: follow(
            resting,
            0.01,
            EndStops(0.0, 0.0),
            replace(TUNING, contact_from="position", band=SIGMA, hysteresis=hysteresis),
        )
        .states[-1]
        .impacts
        for hysteresis in (0.0, 5 * SIGMA)
    }
    assert count[0.0] > 10
    assert count[5 * SIGMA] == 1


@pytest.mark.parametrize("start", [1.0, 0.0])
def test_a_contact_that_is_closed_at_the_start_is_no_impact(start: float):
    state = DucekfState()
    for k in range(50):
        state, result = ducekf(EndStops(0.5, 0.0), TUNING, state, DucekfInputs(True, start + 0.01 * k, 0.01, 1.0))
        assert result == (Result.UPDATED if k else Result.INITIALISED)


def test_a_switch_that_closes_late_does_not_turn_the_estimate_back():
    """Twenty scans after the impact the estimate already leaves the stop."""
    truth = bounce(300, 0.01, kappa=0.8)
    late = replace(truth, contact=np.roll(truth.contact, 20))
    run = follow(late, 0.01, EndStops(0.8, 0.0), replace(TUNING, q_x_dot=1e-2, hold_limit=0.01))
    assert run.states[-1].y_dot == pytest.approx(0.8, abs=0.2)


def test_a_tag_that_is_not_known_neither_hits_nor_holds():
    truth = bounce(300, 0.01, kappa=0.8)
    state, results = DucekfState(), set()
    for x in truth.x:
        state, result = ducekf(EndStops(0.8, 0.0), TUNING, state, DucekfInputs(True, x, 0.01, math.nan))
        results.add(result)
    assert results == {Result.INITIALISED, Result.UPDATED}


@pytest.mark.parametrize(("threshold", "force", "impacts"), [(0.5, 1.0, 1), (50.0, 120.0, 1), (50.0, 40.0, 0)])
def test_a_force_is_a_contact_above_its_threshold(threshold: float, force: float, impacts: int):
    truth, state = bounce(200, 0.01, kappa=0.8), DucekfState()
    tuning = replace(TUNING, threshold=threshold, hold_limit=0.01)
    for x, contact in zip(truth.x, truth.contact, strict=True):
        state, _ = ducekf(EndStops(0.8, 0.0), tuning, state, DucekfInputs(True, x, 0.01, force if contact else 0.1))
    assert state.impacts == impacts


@given(
    kappa=st.floats(0.1, 2.0),
    x=st.floats(0.001, 5.0),
    v=st.floats(0.01, 20.0),
    dt=st.floats(0.001, 0.5),
    mirror=st.booleans(),
)
def test_an_impact_within_the_prediction_is_the_exact_path(kappa: float, x: float, v: float, dt: float, mirror: bool):
    """On noiseless states the folded prediction lies where the body really is, on either side."""
    side = -1.0 if mirror else 1.0
    model = EndStops(kappa, upper=0.0) if mirror else EndStops(kappa, lower=0.0)
    state = DucekfState(init=True, x1=side * x, x2=-side * v, P=(1e-9, 0.0, 0.0, 1e-9), s1=side * x, armed=True)
    until = x / v
    if until >= dt:
        return
    true = side * kappa * v * (dt - until)

    after, result = ducekf(model, TUNING, state, DucekfInputs(True, true, dt, 1.0))

    assert result == Result.IMPACT
    assert after.y == pytest.approx(true, abs=1e-9)  # positions up to 20 in float64, a few operations
    assert after.y_dot == pytest.approx(side * kappa * v, rel=1e-9)


def test_saltation_within_the_prediction_keeps_the_filter_consistent():
    """Mean eᵀP⁻¹e after impacts, ideal 2, with process noise that is true of the axis."""
    values: dict[str, list[float]] = {"saltation": [], "omega": [], "none": []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        dt, kappa, x, v = 0.1, 0.5, 4.0, -1.0
        tuning = replace(TUNING, q_x=1e-5, q_x_dot=1e-4, contact_from="tag", p_x=SIGMA * SIGMA, p_x_dot=1.0)
        states = dict.fromkeys(values, DucekfState())
        since = -1
        for _ in range(70):
            x, v = x + v * dt + float(rng.normal()) * math.sqrt(1e-5), v + float(rng.normal()) * 1e-2
            hit = x < 0.0
            if hit:
                x, v = -kappa * x, -kappa * v
            since = 0 if hit else since + (since >= 0)
            z = x + SIGMA * float(rng.normal())
            for name, nees in values.items():
                model, own = EndStops(kappa, 0.0), replace(tuning, covariance=name)  # type: ignore[arg-type]
                states[name], _ = ducekf(model, own, states[name], DucekfInputs(True, z, dt, float(hit)))
                if 0 <= since < 10:
                    e = np.array([x - states[name].x1, v - states[name].x2])
                    P = np.array(states[name].P).reshape(2, 2)
                    nees.append(float(e @ np.linalg.solve(P, e)))
    mean = {name: float(np.mean(one)) for name, one in values.items()}
    # 40 runs of 10 correlated scans: a standard error of about 0.2
    assert mean["saltation"] == pytest.approx(2.0, abs=0.6)
    assert mean["omega"] < mean["none"] < mean["saltation"] + 0.2
