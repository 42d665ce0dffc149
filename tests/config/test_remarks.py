"""What a configuration is told that is no error."""

import pytest

from softplc.config.models import Config
from softplc.config.remarks import remarks

_SOURCE = {"name": "plc", "type": "opcua", "url": "opc.tcp://127.0.0.1:4841"}


def told(observer: dict[str, object], **axis: object) -> list[str]:
    given = {"name": "X", "input": {"source": "plc", "node": "ns=2;s=X"}, **axis}
    others = observer.get("type", "aoi") in ("fb_kalman", "alpha_beta", "one_euro")
    tuned = {"type": "aoi", **({} if others else {"r_x": 1.0}), **observer}
    return remarks(Config.model_validate({"sources": (_SOURCE,), "axes": ({**given, "observer": tuned},)}))


def test_a_plain_axis_has_nothing_to_remark():
    assert told({}) == []
    assert told({"precision": "real"}, range=(-1e6, 1e6)) == []


@pytest.mark.parametrize("limits", [(0.0, 2.0**24 + 2), (-(2.0**25), 0.0)])
def test_a_real_that_would_lose_counts_in_its_range_is_told_so_unless_it_has_a_reference(limits: tuple[float, float]):
    (text,) = told({"precision": "real"}, range=limits)

    assert text.startswith("X: precision: real at positions up to 1.67772e+07" if limits[0] == 0 else "X: precision")
    assert "set reference" in text
    assert told({"precision": "real", "reference": "first_sample"}, range=limits) == []
    assert told({}, range=limits) == []


def test_a_real_of_another_observer_is_told_what_it_can_do():
    (text,) = told({"type": "fb_kalman", "precision": "real", "R": 1.0}, range=(0.0, 1e9))
    assert text.endswith("set precision: lreal")


def test_bleed_with_its_default_gate_is_told_what_it_does_to_ramps():
    bleed = {"threshold": 1.0, "factor": 0.9}

    (text,) = told({"bleed": bleed})

    assert "makes its velocity read low" in text
    assert told({"bleed": {**bleed, "bleed_gate": "velocity", "velocity_limit": 2.0}}) == []


@pytest.mark.parametrize(
    ("observer", "least"),
    [
        ({"r_x": 1e-4}, "0.000833"),
        ({"type": "fb_kalman", "R": 1e-4}, "0.000833"),
        ({"type": "alpha_beta", "sigma_w": 1.0, "sigma_v": 0.01}, "0.0289"),
    ],
)
def test_a_measurement_noise_below_that_of_the_steps_is_told_what_the_steps_make(
    observer: dict[str, object], least: str
):
    (text,) = told(observer, signal={"quantum": 0.1})
    assert f"quantum²/12; set it to {least} or more" in text


def test_a_noise_of_the_steps_or_more_needs_no_remark():
    for observer in ({"r_x": 0.000833}, {"r_x": 1e-6, "min_r": 0.001}, {"r_x": 1e-6, "r_mode": "density"}):
        assert told(observer, signal={"quantum": 0.1}) == []
    assert told({"type": "one_euro", "beta": 1.0}, signal={"quantum": 0.1}) == []


def test_a_top_speed_that_would_be_rejected_is_told_so():
    adaptive = {"type": "adaptive", "r_x": 1.0, "top_speed": 500.0, "top_acceleration": 1000.0}
    (text,) = told(adaptive, signal={"max_rate": 400.0})
    assert "top_speed 500" in text
    assert told(adaptive, signal={"max_rate": 600.0}) == []
