"""The adaptive observer on tags: what an engineer sees of it, and what nothing may do to it."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from softplc.kernel.reference.adaptive import AdaptiveInputs, AdaptiveState, adaptive
from softplc.observers.adaptive import AdaptiveConfig, AdaptiveKernel
from softplc.observers.axes import AxisSpec
from softplc.observers.kernel import Given
from softplc.sample import Reason, StatusCode
from tests.observers.faults import LIMITS, Fault, apply, assert_back, faults, good
from tests.observers.rig import Rig, make_rig

GOOD = (StatusCode.GOOD, Reason.NONE)
OF_STATE = {
    "Position": "y",
    "Velocity": "y_dot",
    "Acceleration": "y_ddot",
    "Innovation": "y_res",
    "S": "S",
    "K0": "K0",
    "K1": "K1",
    "P00": "P00",
    "P01": "P01",
    "P11": "P11",
    "HoldProbability": "hold",
    "CruiseProbability": "cruise",
    "ManoeuvreProbability": "manoeuvre",
}


def config(**more: float) -> AdaptiveConfig:
    given: dict[str, Any] = {"r_x": 4 / 3, "top_speed": 40.0, "top_acceleration": 80.0, **more}
    return AdaptiveConfig(type="adaptive", **given)


def rig_of(one: AdaptiveConfig, **spec: Any) -> Rig:
    return make_rig((AxisSpec("A0", **spec), one))


def shown(rig: Rig, axis: int = 0) -> list[float]:
    return [rig.get(leaf, axis) for leaf in OF_STATE]


def noisy(seed: int, scans: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, scans)


def test_tags_are_the_reference_bit_for_bit_with_each_axis_own_tuning():
    configs = [config(), config(r_x=0.1, top_speed=5.0), config(top_acceleration=1.0, gate=3.0)]
    rig = make_rig(*[(AxisSpec(f"A{i}"), one) for i, one in enumerate(configs)])
    states = [AdaptiveState() for _ in configs]

    for k, z in enumerate(np.cumsum(np.random.default_rng(7).uniform(-1, 2, (120, 3)), axis=0)):
        dt = 0.05 + 0.004 * (k % 3)
        rig.scan(*z, dt=dt)
        for i, one in enumerate(configs):
            inputs = AdaptiveInputs(True, z[i], dt, one.r_x, one.top_speed, one.top_acceleration, one.gate)
            states[i], _ = adaptive(states[i], inputs)
            assert shown(rig, i) == [getattr(states[i], name) for name in OF_STATE.values()]
            assert rig.get("NIS", i) == states[i].y_res * states[i].y_res / states[i].S


def test_tuning_tags_show_the_machine_s_data_in_its_units():
    rig = make_rig((AxisSpec("A0", unit="mm"), config()))
    rig.scan(1.0)
    leaves = ("r_x", "top_speed", "top_acceleration", "GateSigma")
    assert [rig.get(leaf) for leaf in leaves] == [4 / 3, 40.0, 80.0, 4.0]
    units = {tag.name: tag.unit for block in rig.table.blocks for tag in block.tags}
    assert [units[f"A0.{leaf}"] for leaf in leaves] == ["mm2", "mm/s", "mm/s2", ""]
    assert units["A0.Acceleration"] == "mm/s2"


def test_a_move_from_rest_to_rest_is_seen_as_hold_manoeuvre_cruise_manoeuvre_hold():
    """5 s at rest, to 40 u/s with 80 u/s², 5 s there, back to rest with the same, 5 s at rest; noise U(−2, 2)."""
    rig = rig_of(config())
    t = np.arange(320) * 0.05
    speed = np.clip(np.minimum((t - 5.0) * 80.0, (11.0 - t) * 80.0), 0.0, 40.0)
    truth = np.cumsum(speed) * 0.05
    seen = []
    for z in truth + noisy(4, len(truth)):
        rig.scan(z)
        seen.append([rig.get(leaf) for leaf in OF_STATE])

    values = dict(zip(OF_STATE, np.array(seen).T, strict=True))
    assert values["HoldProbability"][60:100].mean() > 0.8
    assert values["ManoeuvreProbability"][100:116].max() > 0.3
    assert values["CruiseProbability"][140:210].mean() > 0.8
    assert values["ManoeuvreProbability"][210:226].max() > 0.3
    assert values["HoldProbability"][260:].mean() > 0.8
    assert abs(values["Velocity"][260:].mean()) < 0.3  # to rest, where the AOI for this track scatters by 5
    # the mean includes that the axis stops just now, which is 1.5 % of the top speed
    assert values["Velocity"][150:210].mean() == pytest.approx(40.0, abs=1.0)


def test_a_wild_sample_is_left_out_and_said_so_and_the_fourth_in_a_row_is_believed():
    rig = rig_of(config())
    for z in noisy(1, 100):
        rig.scan(z)
    outcomes = []
    for z in (5000.0, 5001.0, 4999.0, 5000.0, 5000.5):
        rig.scan(z)
        outcomes.append((rig.outcome(), abs(rig.get("Position")) < 2.0))

    gate = (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_GATE)
    start = (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert outcomes == [(gate, True)] * 3 + [(start, False), (GOOD, False)]
    assert rig.get("Rejected") == 3.0


def test_disabled_passes_through_and_the_scan_that_enables_starts_anew():
    rig, fresh = rig_of(config(), enable_writable=True), rig_of(config())
    enable = rig.table.index("A0.Enable")
    for k in range(20):
        rig.scan(float(k))

    rig.observer.command(enable, 0.0)
    rig.scan(7.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert (rig.get("Position"), rig.get("Velocity"), rig.get("Acceleration")) == (7.0, 0.0, 0.0)

    rig.observer.command(enable, 1.0)
    for z in (3.0, 3.5, 4.0):
        rig.scan(z)
        fresh.scan(z)
        assert shown(rig) == shown(fresh)


def test_a_start_without_a_time_step_passes_through_and_the_next_scan_starts():
    rig = rig_of(config())

    rig.scan(10.5, dt=0.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DT_INVALID)
    assert (rig.get("Position"), rig.get("Velocity")) == (10.5, 0.0)

    rig.scan(10.5)
    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)


def test_repetitions_are_bridged_with_the_estimated_speed():
    rig = rig_of(config(), on_repeat="predict")
    for k in range(200):
        rig.scan(40.0 * 0.05 * k)
    before = rig.get("Position")

    rig.again()

    assert rig.outcome() == (StatusCode.GOOD, Reason.PREDICTED)
    assert rig.get("Position") == pytest.approx(before + 2.0, abs=0.05)  # without noise the ramp is known well


def test_tuning_that_is_changed_works_from_the_next_step_on_and_keeps_the_state():
    kernel, state = AdaptiveKernel([config()]), AdaptiveState()
    one = np.array([True])
    for k in range(60):
        kernel.tuning["top_speed"][0] = speed = 40.0 if k < 30 else 5.0
        kernel.tuning["r_x"][0] = r_x = 4 / 3 if k < 40 else 0.1
        z = 0.3 * k + noisy(k, 1)[0]
        kernel.step(Given(one, np.array([z]), np.array([0.05]), one, np.array([np.nan])))
        state, _ = adaptive(state, AdaptiveInputs(True, z, 0.05, r_x, speed, 80.0))
        assert (kernel.estimates["Position"][0], kernel.estimates["P00"][0]) == (state.y, state.P00)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"r_x": 0.0}, "greater than or equal to"),
        ({"top_speed": 0.0}, "greater than or equal to"),
        ({"top_acceleration": -1.0}, "greater than or equal to"),
        ({"gate": 1.0}, "greater than or equal to"),
        ({"q_x": 1.0}, "Extra inputs are not permitted"),
    ],
)
def test_a_configuration_that_cannot_work_is_refused(given: dict[str, float], text: str):
    with pytest.raises(ValidationError, match=text):
        config(**given)


AXES = (
    AxisSpec("A0", range=LIMITS),
    AxisSpec("A1", range=LIMITS, dt_source="source", on_repeat="predict", held_after=0.3, enable_writable=True),
    AxisSpec("A2", range=LIMITS, dt_source="arrival", reinit_after=0.3),
    AxisSpec("A3", dt_source="source"),  # no range: numbers of any size are taken
)


@pytest.mark.filterwarnings("error")
@settings(max_examples=60, deadline=None)
@given(scans=st.lists(faults(4), max_size=30))
def test_after_any_faults_one_good_second_brings_every_axis_back(scans: list[Fault]):
    rig = make_rig(*[(spec, config()) for spec in AXES])
    for fault in scans:
        apply(rig, fault)
        for axis in range(len(AXES)):
            status, _ = rig.outcome(axis)
            if status < StatusCode.BAD:
                assert np.isfinite(shown(rig, axis)).all()
                assert 0.0 <= rig.get("K0", axis) <= 1.0

    good(rig, 20)

    assert_back(rig)
    # four scans may pass until a jump is believed; within noise of the measurement then
    assert [rig.get("Position", axis) for axis in range(4)] == pytest.approx([7.0] * 4, abs=2.0)


@settings(max_examples=40, deadline=None)
@given(
    samples=st.lists(
        st.one_of(st.floats(*LIMITS), st.sampled_from([(np.nan,), (np.inf,), (-np.inf,), (1e6,), (-1e308,)])),
        min_size=1,
        max_size=40,
    )
)
def test_what_was_rejected_leaves_no_trace_whatever_it_was(samples: list[float | tuple[float]]):
    one, other = (rig_of(config(), range=LIMITS) for _ in range(2))

    for sample in samples:
        if isinstance(sample, tuple):
            one.scan(*sample)
            if other.scans:
                other.now += other.period
            other.inputs.fail(StatusCode.BAD_SENSOR_FAILURE)
            other.step()
        else:
            one.scan(sample)
            other.scan(sample)
            assert shown(one) == shown(other)


def test_fault_of_one_axis_leaves_the_others_as_they_would_be():
    pair = make_rig((AxisSpec("A0"), config()), (AxisSpec("A1"), config()))
    alone = rig_of(config())
    for k in range(30):
        pair.scan(np.inf if k % 7 == 3 else 1e300, 0.3 * k)
        alone.scan(0.3 * k)
        assert shown(pair, 1) == shown(alone)
