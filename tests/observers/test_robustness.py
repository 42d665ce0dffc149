"""Whatever a source delivers: nothing that is rejected enters the state, and good samples bring the axis back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.aoi import AoiConfig, Bleed
from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, StatusCode
from tests.observers.faults import LIMITS, Fault, apply, assert_back, faults, good
from tests.observers.rig import CONFIG, ESTIMATES, make_rig

AXES: tuple[tuple[AxisSpec, AoiConfig], ...] = (
    (AxisSpec("A0", range=LIMITS), CONFIG),
    (
        AxisSpec("A1", range=LIMITS, dt_source="source", on_repeat="predict", held_after=0.3, enable_writable=True),
        CONFIG,
    ),
    (
        AxisSpec("A2", range=LIMITS, dt_source="arrival", reinit_after=0.3),
        AoiConfig(type="aoi", q_x=1.0, r_x=0.001, bleed=Bleed(threshold=1.0, factor=0.5)),
    ),
    (AxisSpec("A3", dt_source="source"), CONFIG),  # no range: numbers of any size are taken
)


@pytest.mark.filterwarnings("error")
@settings(max_examples=100, deadline=None)
@given(scans=st.lists(faults(4), max_size=30))
def test_after_any_faults_one_good_second_brings_every_axis_back(scans: list[Fault]):
    rig = make_rig(*AXES)
    for fault in scans:
        apply(rig, fault)
        for axis in range(len(AXES)):
            status, _ = rig.outcome(axis)
            if status < StatusCode.BAD:
                assert all(np.isfinite(rig.get(leaf, axis)) for leaf in ("Velocity", "S", "K0", "K1", "P00", "P11"))
                assert 0.0 <= rig.get("K0", axis) <= 1.0

    good(rig, 20)

    assert_back(rig)


@settings(max_examples=10, deadline=None)
@given(scans=st.lists(faults(3), min_size=5, max_size=30))
def test_after_any_faults_an_axis_with_a_range_finds_the_position_again(scans: list[Fault]):
    rig = make_rig(*AXES[:3])
    for fault in scans:
        apply(rig, fault)

    good(rig, 1200)

    positions = [rig.get("Position", axis) for axis in range(3)]
    # the slowest filter's time constant is 0.6 s here; a minute is e^-100, so rounding of the largest number is left
    assert positions == pytest.approx([7.0] * 3, abs=1e-6)


_rejected = st.sampled_from([np.nan, np.inf, -np.inf, 1e6, -1e308])
_accepted = st.floats(-1000.0, 1000.0)


@settings(max_examples=100, deadline=None)
@given(
    samples=st.lists(st.one_of(_accepted, st.tuples(_rejected, _rejected)), min_size=1, max_size=40),
    precision=st.sampled_from(["lreal", "real"]),
)
def test_what_was_rejected_leaves_no_trace_whatever_it_was(
    samples: list[float | tuple[float, float]], precision: str
):
    config = AoiConfig(type="aoi", precision=precision, r_x=4 / 3)  # type: ignore[arg-type]
    spec = AxisSpec("A0", range=LIMITS)
    one, other, bad = make_rig((spec, config)), make_rig((spec, config)), make_rig((spec, config))

    for sample in samples:
        if isinstance(sample, tuple):
            one.scan(sample[0])
            other.scan(sample[1])
            if bad.scans:
                bad.now += bad.period
            bad.inputs.fail(StatusCode.BAD_SENSOR_FAILURE)
            bad.step()
        else:
            for rig in (one, other, bad):
                rig.scan(sample)
            shown = [[rig.get(leaf) for leaf in ESTIMATES] for rig in (one, other, bad)]
            assert shown[0] == shown[1] == shown[2]


def test_a_wild_sample_that_nothing_kept_out_is_told_until_the_estimate_has_found_back():
    rig = make_rig((AxisSpec("A0"), AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3)))
    good(rig, 20)
    rig.scan(1e30)
    told = [rig.outcome()]
    while told[-1][1] and rig.scans < 5000:
        good(rig, 1)
        told.append(rig.outcome())

    assert set(told[:-1]) == {(StatusCode.UNCERTAIN_SUB_NORMAL, Reason.FAR_OFF)}
    assert told[-1] == (StatusCode.GOOD, Reason.NONE)
    assert len(told) > 20  # one good second is not enough after that
    assert abs(rig.get("Position") - rig.get("Raw")) < 1000.0 * np.sqrt(rig.get("S"))
