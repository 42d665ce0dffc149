"""Whatever comes in, in whichever order: nothing that is not a number gets into a state or out as a Good value,
and one good second brings every observer back, or its Reason says why not.

An observer joins by a line in OBSERVERS.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.aoi import AoiConfig, Bleed
from softplc.observers.axes import AxisSpec, ObserverModel
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.derivative import DerivativeConfig
from softplc.observers.ducekf import DucekfConfig, EndStops
from softplc.observers.fb_kalman import FbKalmanConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.leaves import CONSTANTS, JUDGED, LEAVES, STATE
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.one_euro import OneEuroConfig
from softplc.sample import Reason, Sample, StatusCode
from softplc.tags import DataType, Role
from tests.observers.rig import UTC, Rig, make_rig

OBSERVERS: dict[str, ObserverModel] = {
    "aoi": AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3),
    "aoi real": AoiConfig(type="aoi", precision="real", q_x=0.01, q_x_dot=0.1, r_x=4 / 3),
    "aoi with bleed": AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3, bleed=Bleed(threshold=0.5, factor=0.9)),
    "fb_kalman": FbKalmanConfig(type="fb_kalman", Q=0.1, R=1.0),
    "fb_kalman real": FbKalmanConfig(type="fb_kalman", precision="real", Q=0.1, R=1.0),
    "moving_average": MovingAverageConfig(type="moving_average", window=8),
    "finite_difference": FiniteDifferenceConfig(type="finite_difference"),
    "derivative": DerivativeConfig(type="derivative", dt_mode="measured"),
    "alpha_beta": AlphaBetaConfig(type="alpha_beta", alpha=0.5, beta=0.1),
    "one_euro": OneEuroConfig(type="one_euro", beta=0.1),
    "cv_accel": CvAccelConfig(type="cv_accel", q_x_ddot=10.0, r_x=1.0),
    "adaptive": AdaptiveConfig(type="adaptive", r_x=1.0, top_speed=10.0, top_acceleration=50.0),
    "ducekf": DucekfConfig(
        type="ducekf", model=EndStops(type="end_stops", lower=-100.0), contact_from="position", r_x=0.01
    ),
}
PERIOD = 0.05
RANGE = (-1000.0, 1000.0)
GOOD, NONE = StatusCode.GOOD, Reason.NONE
SETTLING = (Reason.INITIALISING, Reason.SETTLING)  # where a written tuning makes the state no number again and again

ODD = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1e308, -1e308, 1.7e308, 3.5e38, -1e39, 5e-324, 1e-46, 1e16)
STATUSES = (
    *[GOOD] * 6,
    StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE,
    StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    StatusCode.BAD_SENSOR_FAILURE,
    StatusCode.BAD_NO_COMMUNICATION,
    StatusCode.BAD_NODE_ID_UNKNOWN,
    StatusCode.BAD_WAITING_FOR_INITIAL_DATA,
    StatusCode.BAD,
)

values = st.one_of(st.sampled_from(ODD), st.floats(-1200, 1200), st.floats(-5, 5))
steps = st.one_of(
    st.just(PERIOD),
    st.floats(0.001, 0.2),
    st.sampled_from([0.0, -0.05, math.nan, math.inf, -math.inf, 5e-324, 1e-9, 0.99, 1.06, 30.0, 1e7]),
)
stamps = st.one_of(
    st.just(None), st.floats(-1.0, 1.0), st.sampled_from([-1e9, 1e9, math.nan])
)  # seconds beside our own clock; NaN: the source sends none


@dataclass(frozen=True)
class Scanned:
    """One scan; without a value nothing new came."""

    z: float | None
    status: int
    dt: float
    stamp: float | None


@dataclass(frozen=True)
class Written:
    """A client wrote a tag; the leaf is chosen among those that the axis has."""

    leaf: float
    value: float


events = st.lists(
    st.one_of(
        st.builds(Scanned, st.one_of(st.none(), values), st.sampled_from(STATUSES), steps, stamps),
        st.builds(Scanned, st.floats(-5, 5), st.just(GOOD), st.just(PERIOD), st.none()),
        st.builds(Written, st.floats(0, 0.999), st.one_of(values, st.floats(0, 10), st.sampled_from([0.0, 1.0]))),
    ),
    max_size=40,
)
axes = st.builds(
    AxisSpec,
    name=st.just("A0"),
    range=st.sampled_from([None, RANGE]),
    enable=st.booleans(),
    enable_writable=st.just(True),
    tuning_writable=st.just(True),
    dt_source=st.sampled_from(["scan", "source", "arrival"]),
    on_repeat=st.sampled_from(["update", "predict"]),
    consistency=st.sampled_from([None, (50, 3)]),
)


def leaves(rig: Rig, role: Role | None = None) -> list[str]:
    tags = next(block for block in rig.table.blocks if block.name == "A0").tags
    return [tag.name.rpartition(".")[2] for tag in tags if role is None or tag.role is role]


def scan(rig: Rig, event: Scanned) -> None:
    """One scan with this event; our own clock never runs backwards, whatever the measured dt says."""
    if math.isfinite(event.dt):
        rig.now += max(event.dt, 0.0)
    if event.z is not None:
        stamp = None if event.stamp is not None and math.isnan(event.stamp) else rig.now + (event.stamp or 0.0)
        bad = event.status >= StatusCode.BAD
        sample = Sample(
            math.nan if bad else event.z, event.status, None if stamp is None else UTC + round(stamp * 1e9)
        )
        rig.inputs.put(0, sample, rig.now)
    rig.step(event.dt)


def write(rig: Rig, event: Written) -> None:
    """What is taken lies within the limits; the rest is refused."""
    writable = leaves(rig, Role.TUNING)
    leaf = writable[int(event.leaf * len(writable))]
    taken = rig.observer.command(rig.table.index(f"A0.{leaf}"), event.value)
    limits = LEAVES[leaf].limits
    if taken and limits is not None:
        assert limits[0] <= event.value <= limits[1]
    assert not taken or math.isfinite(event.value) or leaf in ("Enable", "Reset")


def check(rig: Rig) -> None:
    """What must hold after every scan."""
    status, reason = rig.outcome()  # also: NaN means Bad, one status on all estimates
    assert (status == GOOD) == (reason in (NONE, Reason.PREDICTED)) or reason == Reason.PREDICTED
    assert rig.observer._kernel.finite().all()  # type: ignore[attr-defined]
    names = leaves(rig)
    for leaf in set(names) - {"Raw", *STATE, *CONSTANTS, *JUDGED}:
        assert status >= StatusCode.BAD or math.isfinite(rig.get(leaf)), leaf
    for leaf in set(names) & set(JUDGED):
        assert math.isnan(rig.get(leaf)) == (rig.status(leaf) >= StatusCode.BAD), leaf
        assert not math.isinf(rig.get(leaf)), leaf
    for leaf in leaves(rig, Role.TUNING):
        limits = LEAVES[leaf].limits or ((0.0, 1.0) if leaf in STATE else RANGE)
        no_bleed = leaf == "BleedFactor" and rig.get(leaf) == 1.0  # as built; nobody can write it
        assert no_bleed or limits[0] <= rig.get(leaf) <= limits[1], leaf
        assert LEAVES[leaf].data_type is DataType.DOUBLE or rig.get(leaf) == int(rig.get(leaf))
    assert not rig.get("Dt") < 0.0
    assert rig.get("Age") >= 0.0


def good(rig: Rig, seconds: float, z: float) -> None:
    for k in range(round(seconds / PERIOD)):
        scan(rig, Scanned(z, GOOD, PERIOD, None))
        if k < 5 or k % 20 == 0:
            check(rig)


@pytest.mark.parametrize("name", OBSERVERS)
@settings(max_examples=25, deadline=None)
@given(spec=axes, happened=events, z=st.floats(-5, 5))
def test_one_good_second_brings_the_observer_back_or_its_reason_says_why_not(name, spec, happened, z):
    config = OBSERVERS[name]
    rig = make_rig((spec, config), period=PERIOD)
    for event in happened:
        if isinstance(event, Scanned):
            scan(rig, event)
            check(rig)
        else:
            write(rig, event)

    rig.observer.command(rig.table.index("A0.Enable"), 1.0)
    good(rig, 1.0 + 2 * PERIOD, z)
    status, reason = rig.outcome()
    assert (status, reason) == (GOOD, NONE) or reason in (
        Reason.NOT_FINITE,
        *SETTLING,
        Reason.PREDICTED,
        Reason.FAR_OFF,
    )

    # With the tuning that it was built with, Reset makes it follow again, whatever had been written.
    twin = make_rig((AxisSpec("A0"), config), period=PERIOD)
    good(twin, PERIOD, z)
    for leaf in leaves(rig, Role.TUNING):
        if leaf not in ("Enable", "Reset"):
            rig.observer.command(rig.table.index(f"A0.{leaf}"), twin.get(leaf))
    rig.observer.command(rig.table.index("A0.Reset"), 0.0)
    rig.observer.command(rig.table.index("A0.Reset"), 1.0)
    good(rig, 20.0, z)
    assert rig.outcome() == (GOOD, NONE)
    assert rig.get("Position") == pytest.approx(z, abs=0.01)
    assert rig.get("Velocity") == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("name", OBSERVERS)
@settings(max_examples=25, deadline=None)
@given(bad=st.lists(st.sampled_from([*ODD[:3], 1e4, -1e9]), min_size=1, max_size=15), at=st.integers(1, 60))
def test_rejected_samples_leave_no_trace(name, bad, at):
    """As if they had not come at all; the time that they took is stepped with the next good one."""
    spec = AxisSpec("A0", range=RANGE)
    rig, other = (make_rig((spec, OBSERVERS[name]), period=PERIOD) for _ in range(2))
    for k in range(100):
        z = 0.1 * k
        if k == at:
            for value in bad:
                scan(rig, Scanned(value, GOOD, PERIOD, None))
                check(rig)
                scan(other, Scanned(0.0, StatusCode.BAD_SENSOR_FAILURE, PERIOD, None))
        scan(rig, Scanned(z, GOOD, PERIOD, None))
        scan(other, Scanned(z, GOOD, PERIOD, None))
        estimates = [leaf for leaf in leaves(rig) if leaf not in ("Age", "Raw")]
        assert [rig.get(leaf) for leaf in estimates] == [other.get(leaf) for leaf in estimates]


@pytest.mark.parametrize("name", OBSERVERS)
@pytest.mark.parametrize("gap", [0.5, 0.9, 1.2, 60.0])
def test_a_long_gap_is_stepped_or_starts_anew_by_its_length(name, gap):
    rig = make_rig((AxisSpec("A0"), OBSERVERS[name]), period=PERIOD)
    good(rig, 5.0, 1.0)
    for _ in range(round(gap / PERIOD)):
        scan(rig, Scanned(math.nan, GOOD, PERIOD, None))
        check(rig)
    scan(rig, Scanned(1.0, GOOD, PERIOD, None))
    anew = rig.outcome()[1] == Reason.INITIALISING
    assert anew == (gap > 1.0)
    if not anew:
        assert rig.get("Dt") == pytest.approx(gap + PERIOD)


@pytest.mark.parametrize("name", OBSERVERS)
def test_the_first_scan_may_be_anything(name):
    for event in (
        Scanned(math.nan, GOOD, PERIOD, None),
        Scanned(1e308, GOOD, PERIOD, None),
        Scanned(None, GOOD, math.nan, None),
        Scanned(1.0, GOOD, 0.0, None),
        Scanned(1.0, GOOD, -1.0, None),
        Scanned(1.0, StatusCode.BAD_SENSOR_FAILURE, PERIOD, None),
    ):
        rig = make_rig((AxisSpec("A0", range=RANGE), OBSERVERS[name]), period=PERIOD)
        scan(rig, event)
        check(rig)
        good(rig, 1.0, 2.0)
        assert rig.outcome() == (GOOD, NONE), event


@pytest.mark.parametrize("name", OBSERVERS)
def test_one_axis_in_trouble_leaves_its_neighbours_alone(name):
    config = OBSERVERS[name]
    rig = make_rig((AxisSpec("A0"), config), (AxisSpec("A1"), config), period=PERIOD)
    alone = make_rig((AxisSpec("A0"), config), period=PERIOD)
    rng = np.random.default_rng(0)
    for k in range(300):
        odd = ODD[k % len(ODD)] if k % 3 else rng.normal()
        z = math.sin(0.05 * k)
        rig.scan(odd, z)
        alone.scan(z)
        for leaf in set(leaves(rig)) - {"Age"}:
            assert rig.get(leaf, 1) == alone.get(leaf, 0)
