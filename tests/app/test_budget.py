"""The budget that check predicts: it grows with the axes, warns in time, and is silent where there is room."""

import json
from pathlib import Path
from typing import Any, get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.app.budget import Budget, budgets, warnings
from softplc.app.costs import MEASURED
from softplc.app.layout import build_layout
from softplc.cli.checking import check
from softplc.config.load import load
from softplc.config.models import Config
from softplc.observers.config import ObserverConfig

FOLDER = Path(__file__).parents[2] / "config"
OPCUA = {"name": "plc", "type": "opcua", "url": "opc.tcp://10.0.0.1:4840"}
MODBUS = {"name": "plc", "type": "modbus", "transport": {"type": "tcp", "host": "10.0.0.1"}}
SERIAL = {"name": "plc", "type": "modbus", "transport": {"type": "rtu", "device": "/dev/ttyS0", "baudrate": 9600}}


def budget(axes: int, period_ms: float, source: dict[str, Any] = OPCUA, **keys: Any) -> Budget:
    def tag(number: int) -> dict[str, Any]:
        where = {"node": f"ns=2;s=A{number}"} if source["type"] == "opcua" else {"address": f"holding:{2 * number}"}
        return {"source": "plc", **where, **({} if source["type"] == "opcua" else {"data_type": "float32"})}

    observer = {"type": "aoi", "r_x": 1}
    document = {
        "tasks": [{"period_ms": period_ms}],
        "sources": [{**source, **keys}],
        "axes": [{"name": f"A{number}", "input": tag(number), "observer": observer} for number in range(axes)],
    }
    (found,) = budgets(build_layout(Config.model_validate_json(json.dumps(document))))
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


def test_ten_thousand_axes_at_ten_milliseconds_are_warned_of() -> None:
    found = budget(10_000, 10)

    (text,) = warnings((found,))
    assert found.part > 1
    assert "cannot hold its period" in text
    assert "expected a period_ms of" in text


def test_more_than_half_of_the_period_is_warned_of_and_less_is_not() -> None:
    found = budget(1000, 10_000)
    texts = [
        list(warnings((Budget(found.task, found.total / part, found.shares),))) for part in (0.49, 0.51, 0.99, 1.01)
    ]

    assert texts[0] == []
    assert ["now and then" in text for (text,) in texts[1:3]] == [True, True]
    assert "cannot hold" in texts[3][0]


def test_a_serial_line_is_as_slow_as_its_bits() -> None:
    found = budget(60, 100, SERIAL)

    (device,) = (share.device for share in found.shares if share.requests)
    assert device > 240 * 11 / 9600 * 1000  # the data alone: 120 registers
    assert found.part > 1
    assert budget(60, 100, MODBUS).part < 0.1


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
    assert all(0 < each.part < 0.5 for each in found)


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
    assert "and 950 more" in said.err
    assert len(said.out.splitlines()) == 51
