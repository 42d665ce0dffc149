"""The budget that check predicts: it grows with the axes, warns in time, and is silent where there is room."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.app.budget import Budget, Share, budgets, warnings
from softplc.app.costs import MEASURED
from softplc.app.layout import Layout, build_layout
from softplc.cli.checking import check
from softplc.config.load import load
from softplc.config.models import Config
from softplc.observers.config import ObserverConfig

FOLDER = Path(__file__).parents[2] / "config"
OPCUA = {"name": "plc", "type": "opcua", "url": "opc.tcp://10.0.0.1:4840"}
MODBUS = {"name": "plc", "type": "modbus", "transport": {"type": "tcp", "host": "10.0.0.1"}}
SERIAL = {"name": "plc", "type": "modbus", "transport": {"type": "rtu", "device": "/dev/ttyS0", "baudrate": 9600}}


def layout(axes: int, period_ms: float, source: dict[str, Any] = OPCUA, **keys: Any) -> Layout:
    def tag(number: int) -> dict[str, Any]:
        where = {"node": f"ns=2;s=A{number}"} if source["type"] == "opcua" else {"address": f"holding:{2 * number}"}
        return {"source": "plc", **where, **({} if source["type"] == "opcua" else {"data_type": "float32"})}

    observer = {"type": "aoi", "r_x": 1}
    document = {
        "tasks": [{"period_ms": period_ms}],
        "sources": [{**source, **keys}],
        "axes": [{"name": f"A{number}", "input": tag(number), "observer": observer} for number in range(axes)],
    }
    return build_layout(Config.model_validate_json(json.dumps(document)))


def budget(axes: int, period_ms: float, source: dict[str, Any] = OPCUA, **keys: Any) -> Budget:
    (found,) = budgets(layout(axes, period_ms, source, **keys))
    return found


def measured(axes: int, period_ms: float, answer: float) -> Budget:
    """With a read that took so many ms."""
    (found,) = budgets(layout(axes, period_ms), answers={("main", "plc"): answer})
    return found


@settings(max_examples=15, deadline=None)
@given(few=st.integers(1, 60), more=st.integers(1, 60), source=st.sampled_from([OPCUA, MODBUS, SERIAL]))
def test_more_axes_never_cost_less(few: int, more: int, source: dict[str, Any]) -> None:
    one, other = budget(few, 50, source), budget(few + more, 50, source)

    assert one.total < other.total
    assert one.own < other.own
    assert one.part < other.part


def test_a_shorter_period_has_a_greater_part_of_it_taken() -> None:
    assert budget(100, 10).part == pytest.approx(5 * budget(100, 50).part)


def test_what_softplc_itself_cannot_do_in_time_is_an_error_of_the_period() -> None:
    found = budget(10_000, 2)

    (text,) = warnings((found,))
    assert found.own > found.period
    assert "cannot hold its period: softplc's own share" in text
    assert f"expected a period_ms of {math.ceil(2 * found.own)}," in text


@pytest.mark.parametrize("axes", [5_000, 10_000])
def test_a_slow_answer_is_an_assumption_and_no_error_of_the_period(axes: int) -> None:
    """docs/limits.md measured that 5 000 and 10 000 axes hold 50 ms where the source is quick."""
    found = budget(axes, 50)

    (text,) = warnings((found,))
    assert found.part < 0.2
    assert "if plc answers like a server in node.js beside it, 14 µs a tag" in text
    assert "waits 30 ms of its 50 ms and goes on with older values" in text
    assert "softplc's own share fits" in text
    assert "mode: subscribe" in text
    assert "check --connect measures the answer" in text
    assert "cannot hold" not in text


def test_a_measured_answer_takes_the_place_of_the_assumed_one() -> None:
    quick, slow = (measured(5_000, 50, answer) for answer in (4.0, 40.0))

    assert list(warnings((quick,))) == []
    assert quick.total == pytest.approx(4.0 + quick.own - quick.slowest.own)
    (text,) = warnings((slow,))
    assert "was measured to take 39 ms" in text  # 40 less what softplc needs for the read itself
    assert "--connect" not in text


def test_more_than_half_of_the_period_is_warned_of_and_less_is_not() -> None:
    found = budget(1000, 10_000)
    own = replace(found, shares=tuple(replace(share, device=0.0) for share in found.shares))
    texts = [list(warnings((replace(own, period=own.own / part),))) for part in (0.49, 0.51, 0.99, 1.01)]

    assert texts[0] == []
    assert ["now and then" in text for (text,) in texts[1:3]] == [True, True]
    assert "cannot hold" in texts[3][0]


@given(own=st.floats(0.01, 500), device=st.floats(0, 500), period=st.integers(1, 60_000))
def test_the_period_that_is_advised_is_longer_than_the_one_there_is(own: float, device: float, period: int) -> None:
    shares = (Share("plc 1 tag in", own, device, 1, "plc"),)

    for text in warnings((Budget("main", float(period), shares),)):
        (advised,) = re.findall(r"period_ms of ([0-9.]+)", text)
        assert float(advised) > period


def test_requests_in_flight_are_answered_together() -> None:
    """100 requests of one value: a device that took 2 ms for each needed 213 ms one by one, 28 eight at a time."""
    alone, eight = (budget(100, 50, MODBUS, max_registers=2, in_flight=many) for many in (1, 8))

    assert [found.slowest.requests for found in (alone, eight)] == [100, 100]
    assert eight.slowest.device == pytest.approx(alone.slowest.device * 13 / 100)  # 12 times eight, and four
    assert eight.own < alone.own
    assert "in_flight" in next(warnings((alone,)))
    assert list(warnings((eight,))) == []
    serial = [budget(60, 100, SERIAL, max_registers=2, in_flight=many).slowest.device for many in (1, 8)]
    assert serial[0] == serial[1]  # a line has one request at a time


def test_a_serial_line_is_as_slow_as_its_bits() -> None:
    found = budget(60, 100, SERIAL)

    (device,) = (share.device for share in found.shares if share.requests)
    assert device > 240 * 11 / 9600 * 1000  # the data alone: 120 registers
    assert "takes 298 ms on its line" in next(warnings((found,)))
    assert budget(60, 100, MODBUS).total < 10


def test_requests_are_those_that_the_driver_would_send() -> None:
    def requests(found: Budget) -> int:
        return sum(share.requests for share in found.shares)

    assert requests(budget(100, 50, MODBUS)) == 2  # 200 registers, 125 in one
    assert requests(budget(100, 50, MODBUS, max_registers=20)) == 10
    assert requests(budget(6000, 50)) == 2


@pytest.mark.parametrize("name", ["minimal", "demo", "plant", "observers", "end_stops", "table", "thousand"])
def test_a_shipped_file_has_room(name: str) -> None:
    found = budgets(build_layout(load(FOLDER / f"{name}.yaml")))

    assert list(warnings(found)) == []
    assert all(0 < each.total / each.period < 0.5 for each in found)


def test_every_observer_has_its_cost() -> None:
    union = get_args(ObserverConfig)[0]
    types = {get_args(model.model_fields["type"].annotation)[0] for model in get_args(union)}

    assert types - set(MEASURED.observers) == set()


def test_check_says_the_budget_and_the_counts(capsys: pytest.CaptureFixture[str]) -> None:
    assert check(FOLDER / "thousand.yaml", connect=False, as_json=False) == 0

    said = capsys.readouterr()
    assert "1000 axes, 10 sources, 1 task" in said.err
    assert "task main:" in said.err
    assert "10 sources" in said.err
    assert "predicted from costs measured on" in said.err
    assert "check --connect measures them" in said.err
    assert "and 950 more" in said.err
    assert len(said.out.splitlines()) == 51
