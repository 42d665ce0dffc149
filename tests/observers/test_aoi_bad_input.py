"""The AOI with every kind of option, fed with anything: one good second brings it back, or a flag says why not."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import UTC, Rig, make_rig

LIMITS = (-1000.0, 1000.0)
BLEED = {"threshold": 0.5, "factor": 0.9, "bleed_gate": "velocity", "velocity_limit": 1.0}
CONFIGS: dict[str, dict[str, Any]] = {
    "plain": {},
    "real": {"precision": "real", "bleed": {"threshold": 0.5, "factor": 0.9}},
    "robust": {
        "joseph": True,
        "min_r": 0.1,
        "gate": {"sigma": 5.0, "most_in_a_row": 5},
        "on_s_not_positive": "reinitialise",
        "reference": "first_sample",
        "bleed": BLEED,
    },
    "robust real": {
        "precision": "real",
        "joseph": True,
        "gate": {"sigma": 3.0, "most_in_a_row": 0},
        "reference": 500.0,
        "q_mode": "white_accel",
        "r_mode": "density",
    },
    "limited": {"joseph": True, "gain_limits": {"K0": (0.1, 0.5), "K1": (0.1, 2.0)}, "q_exponents": (2, 1)},
}
SPECS = (
    AxisSpec("A0", range=LIMITS, enable_writable=True),
    AxisSpec("A0", range=LIMITS, enable_writable=True, skipped_time="lose", reinit_after=0.3),
    AxisSpec("A0", range=LIMITS, enable_writable=True, dt_source="source", on_repeat="predict", held_after=0.3),
)

_values = st.one_of(
    st.floats(-1000.0, 1000.0),
    st.sampled_from([np.nan, np.inf, -np.inf, 1e6, -1e308, 1000.0, np.nextafter(1000.0, 2000.0), -0.0, 5e-324]),
)
_statuses = st.sampled_from(
    [
        *[StatusCode.GOOD] * 4,
        StatusCode.UNCERTAIN,
        StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
        StatusCode.BAD_SENSOR_FAILURE,
        StatusCode.BAD_NO_COMMUNICATION,
    ]
)
_steps = st.sampled_from([*[0.05] * 4, 0.0, -1.0, np.nan, 1e-12, 0.9, 3.0, 3600.0, 1e9])
_faults = st.lists(st.tuples(_values, _statuses, _steps, st.sampled_from([True, True, False])), max_size=40)


def feed(rig: Rig, z: float, status: int, dt: float, enable: bool) -> None:
    """One scan; a Bad input has no value, as the image promises, and time goes on by what dt can be."""
    rig.now += dt if 0.0 < dt < 1e5 else 0.05
    rig.observer.command(rig.table.index("A0.Enable"), float(enable))
    rig.inputs.values[0] = np.nan if status >= StatusCode.BAD else z
    rig.inputs.statuses[0] = status
    rig.inputs.source_timestamps[0] = UTC + round(rig.now * 1e9)
    rig.inputs.arrivals[0] = rig.now
    rig.step(dt)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", CONFIGS)
@settings(max_examples=60, deadline=None)
@given(faults=_faults, spec=st.sampled_from(SPECS))
def test_after_any_bad_inputs_one_good_second_brings_the_observer_back(
    name: str, faults: list[tuple[float, int, float, bool]], spec: AxisSpec
):
    config = AoiConfig.model_validate({"type": "aoi", "r_x": 1.0, **CONFIGS[name]})
    rig = make_rig((spec, config))
    for fault in faults:
        feed(rig, *fault)
        status, reason = rig.outcome()  # checks that NaN means Bad and that every tag has its status
        assert (status == StatusCode.GOOD) == (reason in {Reason.NONE, Reason.PREDICTED})
        if status < StatusCode.BAD:
            assert abs(rig.get("Position")) < 1e13  # what stems from a long gap at the speed of a jump is allowed
            assert rig.get("P00") >= 0
            assert rig.get("P11") >= 0
            assert 0 <= rig.get("K0") <= 1

    for _ in range(20):
        feed(rig, 7.0, StatusCode.GOOD, 0.05, True)

    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert np.isfinite([rig.get(leaf) for leaf in ("Position", "Velocity", "S", "K0", "K1", "NIS")]).all()


@pytest.mark.parametrize("name", ["robust", "robust real"])
@settings(max_examples=60, deadline=None)
@given(faults=_faults, spec=st.sampled_from(SPECS))
def test_with_the_gate_one_good_second_brings_the_position_back_as_well(
    name: str, faults: list[tuple[float, int, float, bool]], spec: AxisSpec
):
    """Within what the gate believes: the rest is its ordinary transient."""
    config = AoiConfig.model_validate({"type": "aoi", "r_x": 1.0, **CONFIGS[name]})
    rig = make_rig((spec, config))
    for fault in faults:
        feed(rig, *fault)

    for _ in range(20):
        feed(rig, 7.0, StatusCode.GOOD, 0.05, True)

    sigma = config.gate.sigma if config.gate else 0.0
    assert abs(rig.get("Innovation")) <= sigma * np.sqrt(rig.get("S"))
    assert abs(rig.get("Position") - 7.0) <= sigma * np.sqrt(rig.get("S"))


@pytest.mark.parametrize(("policy", "position"), [("keep", None), ("reinitialise", 7.0)])
@settings(max_examples=30, deadline=None)
@given(faults=_faults)
def test_where_s_cannot_be_positive_a_flag_says_so_and_reinitialise_follows_the_measurement(
    policy: str, position: float | None, faults: list[tuple[float, int, float, bool]]
):
    """No configuration has such an r_x; a tuning that is changed while it runs might."""
    config = AoiConfig(type="aoi", r_x=1.0, on_s_not_positive=policy)  # type: ignore[arg-type]
    rig = make_rig((SPECS[0], config.model_copy(update={"r_x": -1e30})))
    for fault in faults:
        feed(rig, *fault)

    for _ in range(20):
        feed(rig, 7.0, StatusCode.GOOD, 0.05, True)

    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_VARIANCE)
    if position is not None:
        assert rig.get("Position") == position
