import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.timing import Percentiles, Scan, TaskStatistics, Window, next_deadline


def test_next_deadline_stays_on_the_grid_however_late_it_is_asked():
    assert next_deadline(0.0, 0.1, 0.03) == (pytest.approx(0.1), 1)
    assert next_deadline(0.0, 0.1, 0.35) == (pytest.approx(0.4), 4)


def test_a_scan_that_ends_exactly_on_a_slot_waits_for_the_next_one():
    assert next_deadline(0.0, 0.25, 0.5) == (0.75, 3)


@given(
    start=st.floats(0, 1e7),
    period=st.floats(1e-3, 60.0),
    late=st.floats(0, 1e5),
)
def test_next_deadline_is_after_now_and_within_one_period(start, period, late):
    now = start + late
    deadline, slot = next_deadline(start, period, now)
    assert deadline > now
    assert deadline == start + slot * period
    # one period, plus the float's own resolution at this magnitude
    assert deadline - now <= period * (1 + 1e-6) + 4 * abs(now) * 2**-52


def test_percentiles_are_those_of_the_last_window_and_max_is_of_all_time():
    window = Window(100)
    window.add(9.0)
    for value in range(100):
        window.add(value / 100)
    held = window.percentiles()
    assert held == Percentiles(pytest.approx(0.495), pytest.approx(0.9405), pytest.approx(0.9801), 9.0)


def test_an_empty_window_is_zero_not_nan():
    assert Window().percentiles() == Percentiles(0.0, 0.0, 0.0, 0.0)


def test_the_first_scan_has_no_interval_to_judge():
    statistics = TaskStatistics()
    statistics.add(Scan(0, 0.0, 0, 0.05, 0.05, 0), execution=0.001)
    assert statistics.dt.percentiles().max == 0.0
    assert statistics.execution.percentiles().max == 0.001


def test_jitter_is_measured_minus_nominal():
    assert Scan(3, 0.0, 0, 0.062, 0.05, 0).jitter == pytest.approx(0.012)
