"""Counters that roll over: the position goes on, in both directions, and the velocity has no spike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.axes import AxisSpec
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.signal_config import Signal, SignalSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import CONFIG, Rig, make_rig

SPAN = 65536.0 * 0.01  # 16 bits, 0.01 mm a count
DIFFERENCE = FiniteDifferenceConfig(type="finite_difference")


def counter(position: float, *, signed: bool = False) -> float:
    """What is read of a 16-bit counter with scale 0.01 at this position, mm."""
    counts = round(position / 0.01) % 65536
    return (counts - 65536 * (signed and counts >= 32768)) * 0.01


def rig(config: object = CONFIG, **spec: object) -> Rig:
    signal = spec.pop("signal", SignalSpec(counter=SPAN))
    return make_rig((AxisSpec("A0", signal=signal, **spec), config))  # type: ignore[arg-type]


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("speed", [-2000.0, -13.0, 13.0, 2000.0])
def test_position_goes_on_beyond_the_counter_and_velocity_has_no_spike(speed: float, signed: bool):
    """2000 mm/s are 100 mm a scan, and some 30 rollovers in the 200 scans."""
    own, plain = rig(), make_rig()
    for k in range(200):
        position = 300.0 + 0.05 * k * speed
        own.scan(counter(position, signed=signed))
        plain.scan(round(position, 2))
        if k == 0:
            turn = counter(position, signed=signed) - round(position, 2)
        # 1e-6: rounding of the unwrapped position, 1e-12 of 20 m, through gains of some 1/s
        assert own.get("Position") - turn == pytest.approx(plain.get("Position"), abs=1e-6)
        assert own.get("Velocity") == pytest.approx(plain.get("Velocity"), abs=1e-6)
        assert own.get("Raw") == counter(position, signed=signed)
        assert own.outcome() == plain.outcome()


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_motion_below_half_a_span_between_samples_is_followed_with_gaps_in_it(seed: int):
    """Up to 0.42 of the span a scan that changes by up to 0.015, and up to three Bad samples in a row."""
    random = np.random.default_rng(seed)
    own, position, step, missed = rig(DIFFERENCE), 300.0, 0.0, 0
    own.scan(counter(position))
    for k in range(1, 90):
        step = float(np.clip(step + random.uniform(-0.015, 0.015) * SPAN, -0.42 * SPAN, 0.42 * SPAN))
        position += step
        # A gap is followed at the speed before it, to which acceleration adds: none before there is a speed.
        missed = missed + 1 if k > 4 and missed < 3 and random.random() < 0.3 else 0
        own.scan(counter(position), status=StatusCode.BAD_SENSOR_FAILURE if missed else StatusCode.GOOD)
        if not missed:
            assert own.get("Position") == pytest.approx(position, abs=0.006)  # half a count, and rounding


def test_one_wild_sample_of_a_counter_does_not_lead_to_the_wrong_turn():
    """The speed is the median of three; the difference of the last two would look half a span ahead."""
    own = rig(DIFFERENCE)
    for k in range(20):
        own.scan(counter(300.0 + k) if k != 10 else counter(300.0 + k + 0.49 * SPAN))
    assert own.get("Position") == pytest.approx(319.0)


def test_after_a_gap_that_starts_the_observer_anew_the_counter_is_at_its_nearest_turn():
    own = rig(reinit_after=0.5)
    for k in range(100):
        own.scan(counter(300.0 + 30.0 * k))  # 600 mm/s
    own.fail(StatusCode.BAD_NO_COMMUNICATION)
    own.scan(counter(300.0 + 30.0 * 99 + 20.0), dt=5.0)  # and it stopped 20 mm further on
    assert own.get("Position") == pytest.approx(3290.0)
    assert own.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)


def test_the_range_is_that_of_the_unwrapped_position():
    own = rig(range=(0.0, 1000.0))
    for k in range(60):
        own.scan(counter(20.0 * k))
        good = 20.0 * k <= 1000.0
        assert (own.outcome()[1] is Reason.INPUT_OUT_OF_RANGE) is not good
        if not good:
            assert own.status() == StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED
            assert own.status("Raw") == StatusCode.GOOD


def test_a_position_that_is_out_of_range_for_long_is_not_taken_for_another_turn():
    """The counter itself, 355, is inside."""
    own = rig(range=(0.0, 1000.0))
    for k in range(200):
        own.scan(counter(min(20.0 * k, 1010.36)))
    assert own.outcome()[1] is Reason.INPUT_OUT_OF_RANGE


@pytest.mark.parametrize("stamped", [False, True])
def test_a_counter_that_was_set_anew_and_would_be_out_of_range_is_where_it_says(stamped: bool):
    """The PLC restarted and zeroed its counter, a turn away from what we had counted; an axis that has a max_rate."""
    source = "source" if stamped else "scan"
    own = rig(range=(0.0, 1000.0), signal=SignalSpec(counter=SPAN, max_rate=1000.0), dt_source=source)
    for k in range(48):
        own.scan(counter(20.0 * k))
    assert own.get("Position") == pytest.approx(940.0, abs=1.0)
    for _ in range(30):
        own.scan(counter(500.0), stamp=102.5 if stamped else None)  # nearest to 940 is 1155
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert own.get("Position") == pytest.approx(500.0)
    assert own.get("Velocity") == pytest.approx(0.0)


def test_reset_takes_the_counter_as_it_is():
    own = make_rig(AxisSpec("A0", signal=SignalSpec(counter=SPAN), tuning_writable=True))
    for k in range(60):
        own.scan(counter(20.0 * k))
    assert own.get("Position") > SPAN
    assert own.observer.command(own.table.index("A0.Reset"), 1.0)
    own.scan(counter(1200.0))
    assert own.get("Position") == pytest.approx(1200.0 - SPAN)


def test_bad_samples_and_numbers_that_are_none_do_not_move_the_count():
    own = rig()
    for k in range(300):
        value = {3: np.nan, 5: np.inf, 7: -np.inf}.get(k % 11, counter(300.0 + 40.0 * k))
        own.scan(value)
        if np.isfinite(value) and k > 50:
            assert own.get("Position") == pytest.approx(300.0 + 40.0 * k, abs=1.0)  # the AOI has long settled


def test_only_axes_with_a_counter_are_unwrapped():
    own = make_rig(
        (AxisSpec("A0"), DIFFERENCE),
        (AxisSpec("A1", signal=SignalSpec(counter=SPAN)), DIFFERENCE),
        (AxisSpec("A2"), DIFFERENCE),
    )
    for k in range(60):
        own.scan(*(counter(20.0 * k),) * 3)
    assert own.get("Position", 1) == pytest.approx(1180.0)
    assert own.get("Position", 0) == own.get("Position", 2) == pytest.approx(1180.0 - SPAN)


def test_a_slow_source_that_stamps_its_samples_is_followed_by_its_stamps():
    """Each sample stands for two scans; 0.35 of a span between samples."""
    own = rig(DIFFERENCE, dt_source="source", on_repeat="predict")
    for k in range(80):
        sample = k // 2
        own.scan(counter(300.0 + 0.35 * SPAN * sample), stamp=100.0 + 0.1 * sample)
        if not k % 2:
            assert own.get("Position") == pytest.approx(300.0 + 0.35 * SPAN * sample, abs=0.006)


@pytest.mark.parametrize("modulo", [None, 360.0])
@pytest.mark.parametrize("wild", [1e300, -1e17, 2.0 * SPAN])
def test_a_number_that_no_counter_of_that_span_shows_moves_neither_position_nor_count(
    wild: float, modulo: float | None
):
    """1e300 has no digits left to say where in its turn the counter is."""
    own = rig(signal=SignalSpec(counter=SPAN, modulo=modulo))
    twin = rig(signal=SignalSpec(counter=SPAN, modulo=modulo))
    for k in range(100):
        own.scan(wild if k == 50 else counter(5.0 * k))
        twin.scan(float("nan") if k == 50 else counter(5.0 * k))
        if k == 50:
            assert own.outcome() == (StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED, Reason.INPUT_OUT_OF_RANGE)
        assert own.get("Position") == twin.get("Position")


def test_a_counter_whose_tag_has_an_offset_is_followed_over_its_whole_span():
    own = rig(signal=SignalSpec(counter=SPAN, counter_at_0=-1000.0))
    for k in range(300):
        own.scan(counter(5.0 * k) - 1000.0)
        assert own.outcome()[0] < StatusCode.BAD
        assert own.outcome()[1] in (Reason.NONE, Reason.INITIALISING)
    assert own.get("Position") == pytest.approx(5.0 * 299 - 1000.0, abs=0.01)


SIXTEEN = Signal(counter_bits=16).spec(0.01)


@pytest.mark.parametrize(
    ("signal", "spec", "told"),
    [
        (SIXTEEN, {}, Reason.TURNS_UNKNOWN),
        (SIXTEEN, {"range": (0.0, 900.0)}, Reason.TURNS_UNKNOWN),
        (SIXTEEN, {"range": (200.0, 500.0)}, Reason.NONE),  # room for one turn alone
        (Signal(counter_bits=16, max_rate=50.0).spec(0.01), {}, Reason.NONE),  # 250 mm in 5 s, half a span is 328
        (Signal(counter_bits=16, max_rate=80.0).spec(0.01), {}, Reason.TURNS_UNKNOWN),
        (Signal(counter_bits=32).spec(0.01), {}, Reason.NONE),  # 2³¹ counts in 5 s are no axis
    ],
)
def test_a_counter_that_may_have_rolled_over_during_an_outage_is_not_good_until_reset(signal, spec, told):
    own = rig(signal=signal, enable_writable=True, **spec)
    for _ in range(20):
        own.scan(counter(300.0))
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)
    for _ in range(100):
        own.fail(StatusCode.BAD_NO_COMMUNICATION)
    for _ in range(20):
        own.scan(counter(310.0))
    assert own.get("Position") == pytest.approx(310.0, abs=0.1)
    status = StatusCode.GOOD if told is Reason.NONE else StatusCode.UNCERTAIN_SUB_NORMAL
    assert own.outcome() == (status, told)

    own.observer.command(own.table.index("A0.Reset"), 1.0)
    for _ in range(5):
        own.scan(counter(310.0))
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)
