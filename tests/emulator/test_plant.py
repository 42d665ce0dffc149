import math

import numpy as np
import pytest

from softplc.emulator.plant import Plant, quantised, wrapped
from tests.emulator.scenarios import scenario

STEPS = 1200  # of the canonical experiment: 4 × 300 at 50 ms


def measured(plant: Plant, steps: int = STEPS, axis: int = 0) -> list[float]:
    return [plant.at(number).axes[axis].position for number in range(steps)]


def noise(plant: Plant, steps: int = STEPS, axis: int = 0) -> np.ndarray:
    states = [plant.at(number).axes[axis] for number in range(steps)]
    return np.array([state.position - state.true_position for state in states])


def test_the_canonical_experiment_ramps_at_10_units_per_second_and_holds_for_300_steps_each():
    plant = Plant(scenario())
    truth = [plant.at(number).axes[0] for number in range(STEPS + 1)]

    assert [state.true_position for state in truth[::150]] == [0, 75, 150, 150, 150, 225, 300, 300, 300]
    assert [state.true_velocity for state in truth[::150]] == [10, 10, 0, 0, 10, 10, 0, 0, -10]
    assert [state.true_position for state in truth[:300]] == pytest.approx([0.5 * k for k in range(300)], abs=1e-12)


def test_canonical_noise_is_uniform_between_minus_2_and_2_with_variance_four_thirds():
    values = noise(Plant(scenario()), steps=60_000)

    assert values.min() >= -2 and values.max() <= 2
    assert values.min() < -1.99 and values.max() > 1.99
    # four standard errors: mean √(4/3 / n) = 0.0047, variance 4/3 · √(0.8 / n) = 0.0049 (kurtosis 1.8)
    assert values.mean() == pytest.approx(0.0, abs=4 * 0.0047)
    assert values.var() == pytest.approx(4 / 3, abs=4 * 0.0049)
    assert np.corrcoef(values[:-1], values[1:])[0, 1] == pytest.approx(0.0, abs=4 / math.sqrt(60_000))


def test_gaussian_noise_has_the_standard_deviation_it_is_given():
    values = noise(Plant(scenario({"name": "AxisX", "noise": {"type": "gaussian", "std": 0.5}})), steps=20_000)

    assert values.std() == pytest.approx(0.5, rel=4 / math.sqrt(2 * 20_000))  # four standard errors
    assert np.abs(values).max() > 1.5


def test_without_noise_the_measurement_is_the_truth():
    assert not noise(Plant(scenario({"name": "AxisX", "noise": {"type": "none"}}))).any()


def test_a_seed_gives_the_same_measurements_again_and_another_seed_others():
    first = measured(Plant(scenario(seed=7)))

    assert measured(Plant(scenario(seed=7))) == first
    assert measured(Plant(scenario(seed=8))) != first


def test_a_step_is_the_same_whenever_and_however_often_it_is_asked_for():
    chosen = scenario({"name": "AxisX", "faults": [{"type": "nan", "at_s": 1, "for_s": 50, "probability": 0.5}]})
    in_order = [repr(Plant(chosen).at(number)) for number in range(3000)]
    plant = Plant(chosen)

    assert [repr(plant.at(number)) for number in reversed(range(3000))] == in_order[::-1]
    assert [repr(plant.at(number)) for number in (5, 5, 2999, 5)] == [in_order[k] for k in (5, 5, 2999, 5)]


def test_axes_have_their_own_noise_and_keep_it_when_others_are_added():
    alone = Plant(scenario({"name": "AxisX"}))
    both = Plant(scenario({"name": "AxisA"}, {"name": "AxisX"}))

    assert measured(both, axis=1) == measured(alone)
    assert measured(both, axis=0) != measured(both, axis=1)


def test_a_quantised_sensor_reports_multiples_of_its_quantum():
    values = measured(Plant(scenario({"name": "AxisX", "quantum": 0.25})))

    assert all(value % 0.25 == 0 for value in values)
    assert len(set(values)) > 100


def test_count_is_the_measured_position_in_encoder_counts():
    plant = Plant(scenario({"name": "AxisX", "counts_per_unit": 200.0}))

    for number in range(STEPS):
        state = plant.at(number).axes[0]
        assert abs(state.count / 200.0 - state.position) <= 0.5 / 200.0 + 1e-9


@pytest.mark.parametrize(
    ("counts", "shown"),
    [(0.4, 0), (0.5, 1), (-0.5, 0), (-0.6, -1), (2**31 - 1, 2**31 - 1), (2**31, -(2**31)), (-(2**31) - 1, 2**31 - 1)],
)
def test_count_wraps_as_a_signed_32_bit_counter(counts: float, shown: int):
    assert wrapped(counts) == shown


@pytest.mark.parametrize(("value", "quantum", "shown"), [(1.26, 0.25, 1.25), (-0.2, 0.5, 0.0), (1.26, None, 1.26)])
def test_quantised_rounds_to_the_nearest_multiple(value: float, quantum: float | None, shown: float):
    assert quantised(value, quantum) == shown


def test_the_period_sets_the_time_of_a_step_and_not_the_motion():
    slow, fast = Plant(scenario(period_ms=100)), Plant(scenario(period_ms=12.5))

    for number in range(0, 2000, 7):
        assert fast.at(8 * number).axes[0].true_position == slow.at(number).axes[0].true_position
