"""The lamp on simulated mistunings: each axis of a rig is one seeded run, judged at its end."""

import math

import numpy as np
import pytest

from softplc.kernel.diagnosis import Diagnosis
from softplc.observers.aoi import AoiConfig, Bleed
from softplc.observers.axes import AxisSpec
from softplc.observers.consistency import consistency_leaves
from softplc.observers.fb_kalman import FbKalmanConfig
from softplc.sample import Reason, StatusCode
from tests.observers.rig import Rig, make_rig

RUNS, SCANS, DT = 200, 330, 0.05
WINDOWED = ("NISMean", "Autocorrelation", "AutocorrelationMax", "Outside")
FIRM, SOFT = (0.001, 1.0, 0.1), (0.01, 0.1, 4 / 3)  # q_x, q_x_dot, r_x


def track(kind: str, tuning: tuple[float, float, float], rng: np.random.Generator) -> np.ndarray:
    """True positions [scans, runs]: random acceleration as the model has it, ramps and holds, or sines."""
    q_x, q_x_dot, _ = tuning
    t = np.arange(SCANS)[:, np.newaxis] * DT
    if kind == "model":
        v = rng.normal(0, 5, RUNS) + np.cumsum(rng.normal(0, math.sqrt(q_x_dot), (SCANS, RUNS)), axis=0)
        return np.cumsum(v * DT + rng.normal(0, math.sqrt(q_x), (SCANS, RUNS)), axis=0)
    if kind == "ramp-hold":
        phase = (t + rng.uniform(0, 60, RUNS)) % 60
        return np.select([phase < 15, phase < 30, phase < 45], [10 * phase, 150, 150 - 10 * (phase - 30)], 0.0)
    period = 20 if kind == "slow sine" else 8
    return 20 * np.sin(2 * np.pi * t / period + rng.uniform(0, 2 * np.pi, RUNS))


def verdicts(
    kind: str, tuning: tuple[float, float, float], r: float = 1.0, q: float = 1.0, seed: int = 1, **fields: object
) -> np.ndarray:
    """The lamp of every run; the tuning in use has r_x times `r`, and both q times `q`."""
    rng = np.random.default_rng(seed)
    q_x, q_x_dot, r_x = tuning
    config = AoiConfig(type="aoi", q_x=q_x * q, q_x_dot=q_x_dot * q, r_x=r_x * r, **fields)
    rig = make_rig(*[(AxisSpec(f"A{i}", consistency=(200, 5)), config) for i in range(RUNS)])
    for z in track(kind, tuning, rng) + rng.normal(0, math.sqrt(r_x), (SCANS, RUNS)):
        rig.scan(*z)
    return np.array([rig.get("Consistency", axis) for axis in range(RUNS)])


@pytest.mark.parametrize("precision", ["lreal", "real"])
@pytest.mark.parametrize(
    ("kind", "tuning"),
    [("model", FIRM), ("model", SOFT), ("model", (0.001, 0.01, 4 / 3)), ("ramp-hold", SOFT), ("sine", FIRM)],
)
def test_a_right_tuning_is_consistent_and_an_r_that_is_wrong_by_four_is_named(kind, tuning, precision):
    assert np.mean(verdicts(kind, tuning, precision=precision) == Diagnosis.CONSISTENT) >= 0.9
    assert np.mean(verdicts(kind, tuning, r=0.25, precision=precision) == Diagnosis.R_TOO_SMALL) >= 0.95
    assert np.mean(verdicts(kind, tuning, r=4.0, precision=precision) == Diagnosis.R_TOO_LARGE) >= 0.95


@pytest.mark.parametrize(("kind", "tuning"), [("model", FIRM), ("model", SOFT), ("sine", FIRM)])
def test_a_q_that_is_wrong_by_a_hundred_is_named(kind, tuning):
    assert np.mean(verdicts(kind, tuning, q=100.0) == Diagnosis.Q_TOO_LARGE) >= 0.95
    assert np.mean(verdicts(kind, tuning, q=0.01) == Diagnosis.Q_TOO_SMALL) >= 0.9


def test_a_soft_tuning_on_a_fast_track_is_a_q_too_small_whatever_is_wrong_with_the_noise():
    assert np.mean(verdicts("sine", SOFT) == Diagnosis.Q_TOO_SMALL) >= 0.95


def test_bleed_is_named_rather_than_q_or_r_and_a_consistent_axis_may_bleed():
    bleeding = verdicts("ramp-hold", SOFT, bleed=Bleed(threshold=2.0, factor=0.5))
    assert set(bleeding) <= {Diagnosis.BLEED, Diagnosis.CONSISTENT}
    assert np.mean(bleeding == Diagnosis.BLEED) > 0.3
    rare = verdicts("model", FIRM, bleed=Bleed(threshold=1e-6, factor=0.9))
    assert np.mean(rare == Diagnosis.CONSISTENT) >= 0.9


def block(kind: str, variant: str, times: int) -> np.ndarray:
    """The lamp of FB_KalmanFilter with its own Q and an R that is the noise; the task reads each sample `times`."""
    rng = np.random.default_rng(1)
    config = FbKalmanConfig.model_validate({"type": "fb_kalman", "variant": variant, "R": 1.0})
    axes = [(AxisSpec(f"A{i}", consistency=(200, 5)), config) for i in range(RUNS)]
    rig = make_rig(*axes, period=DT / times)
    samples = track(kind, (0.0, config.Q, 1.0), rng) + rng.normal(0, 1, (SCANS, RUNS))
    for z in np.repeat(samples, times, axis=0)[-SCANS:]:
        rig.scan(*z)
    return np.array([rig.get("Consistency", axis) for axis in range(RUNS)])


@pytest.mark.parametrize("kind", ["slow sine", "ramp-hold"])
def test_an_observer_that_swings_is_not_called_consistent_and_the_corrected_one_is(kind):
    swinging = block(kind, "as_written", times=1)
    # its ρ are +0.15 … −0.18, two standard errors of 200 updates: in an eighth of the windows that is not to be seen
    assert np.mean(swinging == Diagnosis.CONSISTENT) < 0.2
    assert np.mean(swinging == Diagnosis.NOT_RANDOM) > 0.65
    assert np.mean(block(kind, "corrected", times=1) == Diagnosis.CONSISTENT) >= 0.9


@pytest.mark.parametrize("kind", ["sine", "slow sine", "ramp-hold"])
def test_an_observer_that_swings_on_samples_that_come_twice_is_never_consistent(kind):
    assert (block(kind, "as_written", times=2) == Diagnosis.NOT_RANDOM).mean() >= 0.95
    assert (block(kind, "corrected", times=2) != Diagnosis.CONSISTENT).all()


def one(seed: int = 4, **fields: object) -> tuple[Rig, np.random.Generator]:
    """An axis with a small window after 80 consistent updates: the window is full."""
    spec = AxisSpec("A0", consistency=(50, 3), **fields)  # type: ignore[arg-type]
    rig = make_rig((spec, AoiConfig(type="aoi", q_x=0.001, q_x_dot=0.01, r_x=1.0)))
    rng = np.random.default_rng(seed)
    for _ in range(80):
        rig.scan(rng.normal())
    assert rig.get("Consistency") == Diagnosis.CONSISTENT
    return rig, rng


def figures(rig: Rig) -> list[float]:
    return [rig.get(leaf) for leaf in (*WINDOWED, "Consistency")]


def test_until_the_window_is_full_the_lamp_is_off_and_figures_are_uncertain():
    rig = make_rig(AxisSpec("A0", consistency=(50, 3)))
    seen: list[tuple[int, float]] = []
    for k in range(70):
        rig.scan(0.1 * k % 1.7)
        seen.append((rig.status("NISMean"), rig.get("Consistency")))
        assert np.isnan(rig.get("NISMean")) == (rig.status("NISMean") >= StatusCode.BAD)
        assert rig.status("Consistency") == StatusCode.GOOD
    settled = 1 + 50 // 4  # the start itself, and a quarter of the window
    waiting, initial = StatusCode.BAD_WAITING_FOR_INITIAL_DATA, StatusCode.UNCERTAIN_INITIAL_VALUE
    assert [status for status, _ in seen] == (
        [waiting] * (settled + 4) + [initial] * 45 + [StatusCode.GOOD] * (70 - settled - 49)
    )
    assert {lamp for status, lamp in seen if status != StatusCode.GOOD} == {Diagnosis.NOT_ENOUGH_DATA}
    assert seen[-1][1] != Diagnosis.NOT_ENOUGH_DATA


def test_the_bands_are_tags():
    rig, _ = one()
    assert rig.get("NISLow") < 1.0 < rig.get("NISHigh")
    assert 0.0 < rig.get("AutocorrelationLimit") < 0.5
    assert {rig.status(leaf) for leaf in ("NISLow", "NISHigh", "AutocorrelationLimit")} == {StatusCode.GOOD}


def test_a_link_that_is_lost_leaves_the_figures_uncertain_and_as_they_were():
    rig, _ = one()
    before = figures(rig)
    for _ in range(10):
        rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    assert figures(rig) == before
    assert {rig.status(leaf) for leaf in WINDOWED} == {StatusCode.UNCERTAIN_LAST_USABLE_VALUE}
    assert rig.status("Consistency") == StatusCode.GOOD


def test_a_value_that_is_held_does_not_count():
    rig, _ = one()
    before = figures(rig)
    for _ in range(3):
        rig.again()
    held = figures(rig)
    for _ in range(300):
        rig.again()
    assert figures(rig) == held
    assert before[-1] == held[-1] == Diagnosis.CONSISTENT


def test_predictions_on_repeated_samples_do_not_count():
    rig, rng = one(dt_source="source", on_repeat="predict")
    other, twin = one(dt_source="source", on_repeat="predict")
    for _ in range(100):
        z = rng.normal()
        assert z == twin.normal()
        rig.scan(z)
        other.scan(z)
        stamp = other.now
        other.scan(z, stamp=stamp, dt=0.0)
        assert other.outcome()[1] == Reason.PREDICTED
    assert figures(rig) == figures(other)


def test_disabled_scans_do_not_count_and_enabling_begins_a_new_window():
    rig, rng = one(enable_writable=True)
    before = figures(rig)
    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    for _ in range(100):
        rig.scan(rng.normal() * 50)
    assert figures(rig) == before
    rig.observer.command(rig.table.index("A0.Enable"), 1.0)
    rig.scan(rng.normal())
    assert rig.get("Consistency") == Diagnosis.NOT_ENOUGH_DATA
    assert rig.status("NISMean") == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
    for _ in range(80):
        rig.scan(rng.normal())
    assert rig.get("Consistency") == Diagnosis.CONSISTENT


def test_rejected_samples_do_not_count():
    rig, rng = one()
    before = figures(rig)
    for _ in range(9):
        rig.scan(math.nan)
    assert figures(rig) == before
    rig.scan(rng.normal(), status=StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)
    assert rig.status("NISMean") == StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE


def test_the_covariance_is_valid_and_its_smallest_eigenvalue_is_that_of_the_published_entries():
    rig, _ = one()
    a, b, c = (rig.get(leaf) for leaf in ("P00", "P01", "P11"))
    assert rig.get("MinEigenvalue") == pytest.approx(np.linalg.eigvalsh([[a, b], [b, c]])[0], rel=1e-6)
    assert rig.get("CovarianceValid") == 1.0


def test_a_covariance_with_a_negative_eigenvalue_lights_the_lamp():
    config = AoiConfig.model_construct(
        type="aoi", precision="lreal", q_x=0.0, q_x_dot=-20.0, r_x=1.0, bleed=None
    )  # what the configuration refuses
    rig = make_rig((AxisSpec("A0", consistency=(50, 3)), config))
    rig.scan(0.0)
    rig.scan(0.0)
    assert rig.get("MinEigenvalue") < 0
    assert (rig.get("CovarianceValid"), rig.get("Consistency")) == (0.0, Diagnosis.COVARIANCE_NOT_VALID)


def test_an_observer_without_innovation_has_no_such_tags():
    assert consistency_leaves(("K0", "P00", "P01", "P11")) == ()
    assert "MinEigenvalue" not in consistency_leaves(("Innovation", "S"))
    assert "Consistency" in consistency_leaves(("Innovation", "S"))
    rig = make_rig(AxisSpec("A0"))
    assert "A0.Consistency" not in rig.table


def test_the_lamp_of_an_axis_is_the_same_beside_others_and_alone():
    """The windows of the two move in different scans, and the gain is another in each scan."""
    config = AoiConfig(type="aoi", q_x=0.01, q_x_dot=100.0, r_x=1.0)
    rng = np.random.default_rng(2)
    both = make_rig(*((AxisSpec(f"A{axis}", consistency=(50, 2)), config) for axis in range(2)))
    alone = make_rig((AxisSpec("A0", consistency=(50, 2)), config))
    lamps = set()
    for k in range(300):
        z, dt = float(rng.normal()), float(rng.choice([0.01, 0.05, 0.5]))
        both.scan(z, math.nan if k % 7 == 0 else z, dt=dt)
        alone.scan(z, dt=dt)
        assert both.get("Consistency") == alone.get("Consistency")
        lamps.add(alone.get("Consistency"))
    assert len(lamps) > 2
