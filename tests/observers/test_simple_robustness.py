"""Whatever a source delivers: nothing rejected enters a state, and good samples bring every observer back."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.axes import AxisSpec
from softplc.sample import StatusCode
from tests.observers.faults import LIMITS, Fault, apply, assert_back, faults, good
from tests.observers.rig import Rig, make_rig
from tests.observers.simple import CASES, NAMES, Case

pytestmark = pytest.mark.parametrize("case", CASES, ids=NAMES)
SPECS = (
    AxisSpec("A0", range=LIMITS),
    AxisSpec("A1", range=LIMITS, dt_source="source", on_repeat="predict", held_after=0.3, enable_writable=True),
    AxisSpec("A2", range=LIMITS, dt_source="arrival", reinit_after=0.3),
    AxisSpec("A3", dt_source="source"),  # no range: numbers of any size are taken
)


def four_axes(case: Case) -> Rig:
    configs = [case.configs[i % len(case.configs)] for i in range(4)]
    return make_rig(*zip(SPECS, configs, strict=True))


@pytest.mark.filterwarnings("error")
@settings(max_examples=40, deadline=None)
@given(sequence=st.lists(faults(4), max_size=30))
def test_after_any_faults_one_good_second_brings_every_axis_back(case: Case, sequence: list[Fault]):
    rig = four_axes(case)
    for fault in sequence:
        apply(rig, fault)
        for axis in range(4):
            status, _ = rig.outcome(axis)
            if status < StatusCode.BAD:
                assert all(np.isfinite(rig.get(leaf, axis)) for leaf in ("Position", "Velocity", *case.leaves))

    good(rig, 20)

    assert_back(rig)


@settings(max_examples=8, deadline=None)
@given(sequence=st.lists(faults(4), min_size=5, max_size=30))
def test_after_any_faults_an_axis_with_a_range_finds_position_and_rest_again(case: Case, sequence: list[Fault]):
    rig = four_axes(case)
    for fault in sequence:
        apply(rig, replace(fault, z=(*fault.z[:3], 7.0)))

    good(rig, 400)

    # the slowest pole here is at 0.95: e^-20 of what was 1e3 times its gain; single precision of 7 is 5e-7
    assert [rig.get("Position", axis) for axis in range(3)] == pytest.approx([7.0] * 3, abs=1e-4)
    assert [rig.get("Velocity", axis) for axis in range(3)] == pytest.approx([0.0] * 3, abs=1e-3)


_rejected = st.sampled_from([np.nan, np.inf, -np.inf, 1e6, -1e308])
_accepted = st.floats(-1000.0, 1000.0)


@settings(max_examples=30, deadline=None)
@given(samples=st.lists(st.one_of(_accepted, st.tuples(_rejected, _rejected)), min_size=1, max_size=30))
def test_what_was_rejected_leaves_no_trace_whatever_it_was(case: Case, samples: list[float | tuple[float, float]]):
    spec = AxisSpec("A0", range=LIMITS)
    one, other, bad = (make_rig((spec, case.configs[0])) for _ in range(3))
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
            leaves = ("Position", "Velocity", *case.leaves, "Dt")
            shown = [[rig.get(leaf) for leaf in leaves] for rig in (one, other, bad)]
            assert shown[0] == shown[1] == shown[2]
