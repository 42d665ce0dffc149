"""Quantum and dead band: what is no motion stays none."""

import numpy as np
import pytest

from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, ObserverModel
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.signal_config import SignalSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import Rig, make_rig

Q = 0.1
STEPS = SignalSpec(quantum=Q)
AOI = AoiConfig(type="aoi", q_x=0.001, q_x_dot=0.1, r_x=Q * Q / 12.0)
DIFFERENCE = FiniteDifferenceConfig(type="finite_difference")


def rig(config: ObserverModel = AOI, signal: SignalSpec | None = STEPS, period: float = 0.01, **spec: object) -> Rig:
    return make_rig((AxisSpec("A0", signal=signal, **spec), config), period=period)  # type: ignore[arg-type]


def rms_velocity(own: Rig, levels: int) -> float:
    """At rest, dithering between so many neighbouring steps at random; from the 300th of 1500 scans on."""
    random, speeds = np.random.default_rng(1), []
    for k in range(1500):
        own.scan(5.0 + Q * int(random.integers(0, levels)))
        if k >= 300:
            speeds.append(own.get("Velocity"))
    return float(np.sqrt(np.mean(np.square(speeds))))


@pytest.mark.parametrize(("levels", "without"), [(2, 0.33), (3, 0.54)])
def test_dither_of_a_step_at_rest_makes_no_velocity(levels: int, without: float):
    """The figures of docs/signal.md."""
    assert rms_velocity(rig(signal=None), levels) == pytest.approx(without, rel=0.05)  # 1200 random steps: 3 %
    assert rms_velocity(rig(), levels) < 1e-6  # what is left of the start, decayed for 3 s


def test_in_motion_the_velocity_is_the_same_and_the_position_one_step_behind():
    for speed in (-30.0, -1.3, 1.3, 30.0):
        own, plain = rig(), rig(signal=None)
        for k in range(600):
            z = Q * round(speed * 0.01 * k / Q)
            own.scan(z)
            plain.scan(z)
        # 1e-4: the play took its step at the start, which has decayed by then
        assert own.get("Velocity") == pytest.approx(plain.get("Velocity"), abs=1e-4)
        behind = plain.get("Position") - own.get("Position")
        assert behind == pytest.approx(np.copysign(Q, speed), abs=1e-4)


def test_a_step_over_a_tiny_time_makes_no_spike():
    """Readings in pairs, 0.1 ms apart, of an axis at 1 mm/s; a step over 0.1 ms would be 1000 mm/s."""
    own, worst = rig(), 0.0
    for k in range(1000):
        t = 0.01 * (k // 2) + 1e-4 * (k % 2)
        own.scan(Q * np.floor(1.0 * t / Q), dt=1e-4 if k % 2 else 0.0099)
        worst = max(worst, abs(own.get("Velocity") - 1.0) if k > 200 else 0.0)
    assert worst < 0.6
    own = rig(DIFFERENCE)
    for k in range(1000):  # at rest, and dithering between the two of a pair
        own.scan(Q * (k % 2), dt=1e-4 if k % 2 else 0.0099)
        assert own.get("Velocity") == pytest.approx(0.0, abs=1e-9)


def test_the_play_never_leaves_a_step_of_what_was_read():
    own, random, z = rig(DIFFERENCE), np.random.default_rng(2), 0.0
    for _ in range(2000):
        z += Q * int(random.integers(-2, 3))
        own.scan(z)
        assert abs(own.get("Position") - z) <= Q * (1 + 1e-9)
        assert own.get("Raw") == z


def test_a_change_below_the_dead_band_is_none_and_one_above_is_all_of_it():
    own = rig(DIFFERENCE, SignalSpec(dead_band=0.5))
    given = [0.0, 0.4, -0.4, 0.3, 0.5, 0.8, 0.1, 0.0, -0.01]
    seen = []
    for z in given:
        own.scan(z)
        seen.append(own.get("Position"))
        assert own.get("Raw") == z
    assert seen == [0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.0, 0.0]


def test_noise_within_the_dead_band_brings_the_velocity_to_zero():
    own, random = rig(AOI, SignalSpec(dead_band=0.5)), np.random.default_rng(4)
    for _ in range(600):
        own.scan(3.0 + random.uniform(-0.2, 0.2))
    assert own.get("Velocity") == pytest.approx(0.0, abs=1e-6)
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)


def test_a_slow_motion_is_not_lost_in_the_dead_band():
    """The change counts from the last value passed on: it adds up."""
    own = rig(DIFFERENCE, SignalSpec(dead_band=0.5))
    for k in range(1000):
        own.scan(0.01 * k)
        assert abs(own.get("Position") - 0.01 * k) < 0.5 + 1e-9


@pytest.mark.parametrize("signal", [STEPS, SignalSpec(dead_band=0.5)])
def test_a_start_anew_begins_at_what_is_read(signal: SignalSpec):
    own = rig(DIFFERENCE, signal, reinit_after=0.5, reinit_samples=1)
    for z in (0.0, 0.0, 0.05):
        own.scan(z)
    own.scan(0.07, dt=2.0)
    assert own.get("Position") == 0.07


def test_play_and_dead_band_work_across_the_edge_of_a_turn():
    own = rig(DIFFERENCE, SignalSpec(modulo=360.0, quantum=Q, dead_band=0.05))
    for k in range(400):
        own.scan([0.0, 359.9][k % 2])
        assert own.get("Velocity") == pytest.approx(0.0, abs=1e-9)
    for k in range(2000):
        own.scan((Q * 3 * k) % 360.0)
        if k > 10:
            assert own.get("Velocity") == pytest.approx(30.0, abs=1e-6)
