"""The DUCEKF as an observer: impacts by tag or position, holds, and the paper's oscillator on live tags."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from softplc.kernel.reference import dhvpo
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, DucekfTuning, ducekf
from softplc.kernel.reference.end_stops import EndStops
from softplc.observers.axes import AxisSpec
from softplc.observers.ducekf import DucekfConfig, DucekfKernel
from softplc.observers.kernel import Given
from softplc.sample import Reason, Sample, StatusCode
from tests.kernel.bounce import Truth, bounce
from tests.observers.faults import FAR_OFF, LIMITS, Fault, apply, faults, good
from tests.observers.rig import ESTIMATES, UTC, Rig, make_rig

GOOD = (StatusCode.GOOD, Reason.NONE)
SIGMA = 0.01


def config(model: dict[str, Any] | None = None, **more: Any) -> DucekfConfig:
    stops = {"type": "end_stops", "lower": 0.0, "upper": 3.0, "restitution": 0.8}
    tuning: dict[str, Any] = {"q_x": 1e-6, "q_x_dot": 1e-4, "r_x": SIGMA * SIGMA, **more}
    return DucekfConfig.model_validate({"type": "ducekf", "model": model or stops, **tuning})


def rig_of(one: DucekfConfig, period: float = 0.05, **spec: Any) -> Rig:
    return make_rig((AxisSpec("A0", **spec), one), period=period, contact_tag=one.needs_contact)


def contact(rig: Rig, value: float, status: int = StatusCode.GOOD) -> None:
    """Set the contact tag for the next scan."""
    rig.inputs.put(len(rig.inputs.values) - 1, Sample(value, status, UTC), rig.next)


def follow(rig: Rig, truth: Truth, sigma: float = SIGMA) -> tuple[list[int], list[float]]:
    """Noisy samples of a bouncing axis: the scans in which Impacts went up, and the velocities."""
    rng, hits, velocities, tagged = np.random.default_rng(3), [], [], len(rig.inputs.values) > 1
    for k, (x, touched) in enumerate(zip(truth.x, truth.contact, strict=True)):
        before = rig.get("Impacts") if k else 0.0
        if tagged:
            contact(rig, float(touched))
        rig.scan(x + sigma * float(rng.normal()))
        if rig.get("Impacts") > before:
            hits.append(k)
        velocities.append(rig.get("Velocity"))
    return hits, velocities


@pytest.mark.parametrize("contact_from", ["tag", "either"])
@pytest.mark.parametrize("period", [0.05, 0.7])
def test_a_bouncing_axis_with_a_contact_tag_has_its_new_velocity_in_the_scan_of_the_impact(
    contact_from: str, period: float
):
    truth = bounce(round(40 / period), period, kappa=0.8, upper=3.0, x=2.517)
    rig = rig_of(config(contact_from=contact_from), period)

    hits, velocities = follow(rig, truth)

    assert len(truth.impacts) >= 3
    # `either` may find it by the position a scan sooner, when the impact falls near a sample
    assert hits == truth.impacts if contact_from == "tag" else np.allclose(hits, truth.impacts, atol=1)
    after = [abs(velocities[k] - truth.v[k]) for k in truth.impacts]
    assert max(after) < 0.1  # 6 % of the change
    assert rig.get("Impacts") == len(truth.impacts)


@pytest.mark.parametrize("period", [0.02, 0.1, 0.7])
def test_by_position_alone_no_impact_tunnels_through_a_long_scan(period: float):
    truth = bounce(round(40 / period), period, kappa=0.8, upper=3.0, x=2.517)
    hits, velocities = follow(rig_of(config(contact_from="position"), period), truth)

    assert np.allclose(hits, truth.impacts, atol=1)
    assert np.median(abs(velocities - truth.v)) < 0.03


def test_impacts_are_good_and_the_contact_is_a_tag():
    truth, rig = bounce(60, 0.05, kappa=0.8, upper=3.0), rig_of(config())
    outcomes, contacts = [], []
    for x, touched in zip(truth.x, truth.contact, strict=True):
        contact(rig, float(touched))
        rig.scan(x)
        outcomes.append(rig.outcome())
        contacts.append(rig.get("Contact"))
    assert outcomes == [(StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING), *[GOOD] * 59]
    assert contacts == truth.contact.tolist()


def test_an_estimate_that_waits_at_the_stop_says_so_and_ends_with_the_contact():
    rig = rig_of(config(q_x_dot=1e-10, r_x=1.0, band=0.04, hold_limit_ms=60_000), 0.01)
    x, v, seen = 2.0, -1.0, []
    contact(rig, 0.0)
    for _ in range(290):
        v = -0.6 if x < 1.0 else v
        x = max(x + v * 0.01, 0.0)
        contact(rig, float(x <= 0.0))
        rig.scan(x)
        seen.append((*rig.outcome(), rig.get("Impacts"), rig.get("Position")))

    held = [k for k, (_, reason, _, _) in enumerate(seen) if reason == Reason.HELD_AT_STOP]
    assert len(held) > 3
    assert {seen[k][0] for k in held} == {StatusCode.UNCERTAIN_SUB_NORMAL}
    assert len({seen[k][3] for k in held}) == 1
    first_after = seen[held[-1] + 1]
    assert (first_after[:2], first_after[2]) == (GOOD, 1.0)


def test_a_contact_that_never_comes_starts_the_filter_anew():
    rig = rig_of(config(q_x_dot=1e-10, r_x=1.0, band=0.04, hold_limit_ms=100.0), 0.01)
    reasons = []
    for k in range(400):
        contact(rig, 0.0)
        rig.scan(max(3.0 - 0.01 * k, 0.5))
        reasons.append(rig.outcome()[1])
    assert reasons.count(Reason.HELD_AT_STOP) == pytest.approx(10, abs=1)
    assert reasons.count(Reason.INITIALISING) == 2
    assert reasons[-1] == Reason.NONE
    assert rig.get("Position") == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("status", [StatusCode.BAD_NO_COMMUNICATION, StatusCode.BAD_SENSOR_FAILURE])
def test_a_bad_contact_tag_makes_it_an_ordinary_filter(status: int):
    truth, rig = bounce(100, 0.05, kappa=0.8, upper=3.0, x=2.517), rig_of(config())
    for x in truth.x:
        contact(rig, math.nan, status)
        rig.scan(x)
    assert (rig.get("Impacts"), *rig.outcome()) == (0.0, *GOOD)


def test_tags_are_the_reference_bit_for_bit_with_each_axis_own_tuning():
    configs = [
        config({"type": "end_stops", "lower": 0.0, "upper": 3.0, "restitution": kappa}, r_x=r_x, q_x_dot=q)
        for kappa, r_x, q in ((0.8, 1e-4, 1e-4), (0.0, 1e-2, 1e-2), (1.0, 3e-4, 1e-6))
    ]
    rig = make_rig(*[(AxisSpec(f"A{i}"), one) for i, one in enumerate(configs)], contact_tag=True)
    states, truth = [DucekfState() for _ in configs], bounce(300, 0.05, kappa=0.8, upper=3.0, x=2.517)
    rng = np.random.default_rng(5)
    for x, touched in zip(truth.x, truth.contact, strict=True):
        z = x + SIGMA * rng.normal(size=3)
        contact(rig, float(touched))
        rig.scan(*z)
        for i, one in enumerate(configs):
            band = 4.0 * math.sqrt(one.r_x)
            tuning = DucekfTuning(
                one.q_x,
                one.q_x_dot,
                one.r_x,
                band,
                covariance="saltation",
                contact_from="tag",
                impact_scan="within",
                hysteresis=band,
                hold_limit=0.5,
                p_x=one.r_x,
            )
            model = EndStops(one.model.restitution, 0.0, 3.0)
            states[i], _ = ducekf(model, tuning, states[i], DucekfInputs(True, z[i], 0.05, float(touched)))
            s = states[i]
            expected = [s.y, s.y_dot, s.y_res, s.S, s.K0, s.K1, s.P[0], s.P[1], s.P[3]]
            assert [rig.get(leaf, i) for leaf in ESTIMATES[:9]] == expected
            assert (rig.get("Impacts", i), rig.get("Contact", i)) == (s.impacts, s.touching)
    assert min(state.impacts for state in states) >= 3


@pytest.mark.parametrize("contact_from", ["tag", "position"])
def test_the_oscillator_of_the_paper_is_followed_on_live_tags(contact_from: str):
    """Q, R, band and Δt of Table 1; the start is the first measurement, as live axes start."""
    scans = dhvpo.run(1400)
    table_1 = {"q_x": 0.001, "q_x_dot": 0.001, "r_x": 1e-4, "band": 0.02, "impact_covariance": "omega"}
    rig = rig_of(config({"type": "dhvpo"}, contact_from=contact_from, **table_1), 0.01)
    hits = []
    for scan in scans:
        before = rig.get("Impacts") if rig.scans else 0.0
        if contact_from == "tag":
            contact(rig, float(scan.impact))
        rig.scan(scan.x[0])
        if rig.get("Impacts") > before:
            hits.append(scan.k)
    assert hits == [315, 646, 977, 1308]
    assert rig.get("Velocity") == pytest.approx(scans[-1].x[1], abs=1e-3)


@pytest.mark.parametrize(("stop", "leaves"), [("lower", {"LowerStop"}), ("upper", {"UpperStop"})])
def test_tuning_tags_show_what_is_used_and_only_the_stops_that_are(stop: str, leaves: set[str]):
    one = config({"type": "end_stops", stop: 2.5, "restitution": 0.3}, contact_from="position", r_x=0.04)
    rig = rig_of(one)
    rig.scan(1.0)
    names = {tag.name.rpartition(".")[2] for block in rig.table.blocks for tag in block.tags}
    assert names & {"LowerStop", "UpperStop"} == leaves
    assert [rig.get(leaf) for leaf in ("Restitution", "Band", "r_x", *leaves)] == [0.3, pytest.approx(0.8), 0.04, 2.5]


def test_tuning_that_is_changed_works_from_the_next_step_on_and_keeps_the_state():
    kernel, one = DucekfKernel([config(contact_from="position")]), np.array([True])
    for k in range(100):
        kernel.step(Given(one, np.array([1.0 + 0.01 * k]), np.array([0.05]), one, np.array([np.nan])))
    velocity, P00 = float(kernel.estimates["Velocity"][0]), float(kernel.estimates["P00"][0])
    kernel.tuning["r_x"][0] = 100.0
    kernel.step(Given(one, np.array([2.0]), np.array([0.05]), one, np.array([np.nan])))
    assert kernel.estimates["Velocity"][0] == pytest.approx(velocity, rel=1e-3)
    assert kernel.estimates["P00"][0] >= P00


def test_a_prediction_between_samples_ends_at_the_stop():
    rig = rig_of(config(contact_from="position"), 0.1, dt_source="source", on_repeat="predict")
    for k in range(25):
        rig.scan(2.65 - 0.1 * k)
    positions = []
    for _ in range(5):
        rig.again()
        positions.append(rig.get("Position"))
    assert rig.outcome()[1] == Reason.PREDICTED
    assert positions == pytest.approx([0.15, 0.05, 0.0, 0.0, 0.0], abs=0.01)


def test_axes_with_other_models_choices_or_stops_are_stepped_apart():
    some = [
        config(),
        config(contact_from="either"),
        config(impact_covariance="omega"),
        config({"type": "dhvpo"}),
        config({"type": "dhvpo", "band_reading": "below"}),
    ]
    assert len({one.group_key for one in some}) == len(some)
    with pytest.raises(ValueError, match="group_key"):
        make_rig((AxisSpec("A0"), some[0]), (AxisSpec("A1"), some[1]))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"model": {"type": "end_stops"}}, "at least one stop"),
        ({"model": {"type": "end_stops", "lower": 3.0, "upper": 3.0}}, "lower 3 is not below upper 3"),
        ({"model": {"type": "end_stops", "lower": 0.0}, "impact_covariance": "omega"}, "divides by the restitution"),
        (
            {"model": {"type": "dhvpo", "restitution": 0.0}, "impact_covariance": "omega"},
            "divides by the restitution",
        ),
        ({"model": {"type": "dhvpo", "mu": 0.0}}, "greater than or equal to 0.001"),
        ({"r_x": 0.0}, "greater than 0"),
        ({"band": 0.0}, "greater than 0"),
    ],
)
def test_a_configuration_that_cannot_work_is_refused(given: dict[str, Any], text: str):
    with pytest.raises(ValidationError, match=text):
        config(**given)


AXES = (
    AxisSpec("A0", range=LIMITS),
    AxisSpec("A1", range=LIMITS, dt_source="source", on_repeat="predict", held_after=0.3, enable_writable=True),
    AxisSpec("A2", range=LIMITS, dt_source="arrival", reinit_after=0.3),
    AxisSpec("A3", dt_source="source"),  # no range: numbers of any size are taken
)
STOPS = {"type": "end_stops", "lower": -500.0, "upper": 500.0, "restitution": 0.5}


@pytest.mark.parametrize("contact_from", ["tag", "position", "either"])
@pytest.mark.parametrize("covariance", ["omega", "saltation"])
@pytest.mark.filterwarnings("error")
@settings(max_examples=40, deadline=None)
@given(scans=st.lists(faults(5), max_size=30))
def test_after_any_faults_one_good_second_brings_every_axis_back(
    contact_from: str, covariance: str, scans: list[Fault]
):
    """Or a flag says that it waits for its contact, no longer than it may. The fifth value is the contact tag's."""
    one = config(STOPS, contact_from=contact_from, impact_covariance=covariance)
    rig = make_rig(*[(spec, one) for spec in AXES], contact_tag=True)
    for fault in scans:
        apply(rig, fault)
        for axis in range(len(AXES)):
            status, _ = rig.outcome(axis)
            if status < StatusCode.BAD:
                assert all(np.isfinite(rig.get(leaf, axis)) for leaf in (*ESTIMATES[:2], *ESTIMATES[3:9]))
                assert 0.0 <= rig.get("K0", axis) <= 1.0

    good(rig, 20)
    waits = (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.HELD_AT_STOP)
    waited_in_vain = (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert {rig.outcome(axis) for axis in range(4)} <= {GOOD, waits, waited_in_vain, FAR_OFF}

    good(rig, 40)  # a wait ends after 0.5 s, and a filter that starts anew at rest is not at a stop
    assert [rig.outcome(axis) for axis in range(3)] == [GOOD] * 3


@settings(max_examples=10, deadline=None)
@given(scans=st.lists(faults(4), min_size=5, max_size=30))
def test_after_any_faults_an_axis_with_a_range_comes_to_the_position_again(scans: list[Fault]):
    rig = make_rig(*[(spec, config(STOPS, q_x_dot=0.1, r_x=1.0)) for spec in AXES[:3]], contact_tag=True)
    for fault in scans:
        apply(rig, fault)

    good(rig, 1200)

    # the slowest pole is at 0.87 here; a minute is e^-160, so rounding of the largest number is left
    assert [rig.get("Position", axis) for axis in range(3)] == pytest.approx([7.0] * 3, abs=1e-6)
    assert [rig.get("Velocity", axis) for axis in range(3)] == pytest.approx([0.0] * 3, abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(scans=st.lists(faults(2), max_size=20))
def test_after_any_faults_the_oscillator_is_followed_again_or_a_flag_says_why_not(scans: list[Fault]):
    one = config({"type": "dhvpo"}, contact_from="either", band=0.02)
    rig = make_rig((AxisSpec("A0", range=(-2.0, 2.0)), one), contact_tag=True, period=0.01)
    for fault in scans:
        apply(rig, fault)
        status, _ = rig.outcome()
        if status < StatusCode.BAD:
            assert np.isfinite([rig.get(leaf) for leaf in ESTIMATES[:9]]).all()

    x = (0.5, 1.0)
    for _ in range(150):  # on its way to the top, far from the surface
        contact(rig, 0.0)
        rig.scan(x[0])
        x = dhvpo.Dhvpo().f(*x, 0.01)
    assert rig.outcome() == GOOD
    assert rig.get("Position") == pytest.approx(x[0], abs=0.05)


def test_what_was_rejected_leaves_no_trace():
    one, other = (rig_of(config(contact_from="position"), range=LIMITS) for _ in range(2))
    truth = bounce(200, 0.05, kappa=0.8, upper=3.0, x=2.517)
    for k, x in enumerate(truth.x):
        if k % 17 == 5:
            one.scan(math.nan if k % 2 else 1e6)
            other.now += other.period
            other.inputs.fail(StatusCode.BAD_SENSOR_FAILURE)
            other.step()
        else:
            one.scan(x)
            other.scan(x)
            assert [one.get(leaf) for leaf in ESTIMATES] == [other.get(leaf) for leaf in ESTIMATES]


def test_a_disabled_axis_starts_anew_and_keeps_its_count():
    rig = rig_of(config(contact_from="position"), 0.05, enable_writable=True)
    follow(rig, bounce(100, 0.05, kappa=0.8, upper=3.0, x=2.517), sigma=0.0)
    count = rig.get("Impacts")
    enable = rig.table.index("A0.Enable")

    rig.observer.command(enable, 0.0)
    rig.scan(1.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    rig.observer.command(enable, 1.0)
    rig.scan(1.5)
    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert (rig.get("Position"), rig.get("Velocity"), rig.get("Impacts")) == (1.5, 0.0, count)
    assert count == 1
