"""The block `signal` and the dead time of a configuration, as the observers and the servers see them."""

from typing import Any

import pytest

from softplc.app.layout import axis_spec, build_layout
from softplc.config.models import Config

_SOURCES = (
    {"name": "plc", "type": "modbus", "transport": {"host": "127.0.0.1"}},
    {"name": "ua", "type": "opcua", "url": "opc.tcp://127.0.0.1:4841"},
)
_COUNTS = {"source": "plc", "address": "holding:0", "data_type": "uint16"}


def config(tag: dict[str, Any], **axis: Any) -> Config:
    one = {"name": "X", "unit": "mm", "input": tag, "observer": {"type": "aoi", "r_x": 1.0}, **axis}
    return Config.model_validate({"sources": _SOURCES, "axes": (one,)})


@pytest.mark.parametrize(
    ("tag", "bits", "span"),
    [
        (_COUNTS, 16, 65536.0),
        ({**_COUNTS, "scale": 0.001, "offset": 500.0}, 16, 65.536),
        ({**_COUNTS, "scale": -0.5}, 16, 32768.0),
        ({**_COUNTS, "data_type": "int32", "scale": 0.25}, 32, 2.0**30),
        ({"source": "ua", "node": "ns=2;s=X"}, 16, 65536.0),
    ],
)
def test_the_span_of_a_counter_is_that_of_its_bits_in_the_unit_of_the_axis(
    tag: dict[str, Any], bits: int, span: float
):
    (axis,) = config(tag, signal={"counter_bits": bits}).axes
    signal = axis_spec(axis).signal
    assert signal is not None
    assert signal.counter == pytest.approx(span)


def test_an_axis_without_these_keys_has_neither():
    spec = axis_spec(config(_COUNTS).axes[0])
    assert spec.signal is None
    assert spec.dead_time is None


def test_the_state_of_now_can_be_written_back():
    back = ({"output": "PositionNow", "tag": {"source": "plc", "address": "holding:10"}},)
    layout = build_layout(config(_COUNTS, dead_time_ms=12.5, write_back=back))
    (task,) = layout.tasks
    assert layout.table.tags[task.write_backs[0].index].name == "X.PositionNow"
    assert task.observers[0].places[0].spec.dead_time == 0.0125


def test_the_ranges_that_an_hmi_sees_are_those_of_what_is_shown():
    def ranges(**axis: Any) -> tuple[Any, Any]:
        tags = {tag.name: tag.range for tag in build_layout(config(_COUNTS, **axis)).table}
        return tags["X.Position"], tags["X.Raw"]

    plain = (-100.0, 1000.0)
    assert ranges(range=plain) == (plain, plain)
    assert ranges(range=plain, signal={"counter_bits": 16}) == (plain, None)
    assert ranges(range=plain, signal={"modulo": 360}) == ((0.0, 360.0), plain)


def test_axes_with_and_without_a_signal_are_stepped_together():
    one = config(_COUNTS, signal={"modulo": 360}).axes[0]
    two = config({**_COUNTS, "address": "holding:1"}).axes[0].model_copy(update={"name": "Y"})
    both = config(_COUNTS).model_copy(update={"axes": (one, two)})
    assert len(build_layout(both).tasks[0].observers) == 1
