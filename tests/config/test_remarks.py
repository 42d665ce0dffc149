"""What a configuration is told that is no error."""

import pytest

from softplc.config.models import Config
from softplc.config.remarks import remarks

_SOURCE = {"name": "plc", "type": "opcua", "url": "opc.tcp://127.0.0.1:4841"}


def told(observer: dict[str, object], **axis: object) -> list[str]:
    given = {"name": "X", "input": {"source": "plc", "node": "ns=2;s=X"}, **axis}
    tuned = {"type": "aoi", **({} if "R" in observer else {"r_x": 1.0}), **observer}
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
