import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from ruamel.yaml import YAML

from softplc.emulator.motion import RampHold
from softplc.emulator.noise import UniformNoise
from softplc.emulator.scenario import Scenario
from tests.emulator.scenarios import scenario


def test_a_scenario_needs_no_more_than_a_name_and_a_server_to_be_the_canonical_experiment():
    chosen = scenario({"name": "AxisX"}, modbus={})

    axis = chosen.axes[0]
    assert (chosen.period_ms, chosen.seed) == (50.0, 0)
    assert axis.motion.model_dump() == {"type": "ramp_hold", "slope": 10.0, "segment_s": 15.0, "start": 0.0}
    assert axis.noise.model_dump() == {"type": "uniform", "half_width": 2.0}


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"modbus": None}, "found neither opcua nor modbus"),
        ({"opcua": {"port": 5000}, "modbus": {"port": 5000}}, "both have port 5000"),
        ({"axes": [{"name": "A"}, {"name": "A"}]}, "found A 2 times"),
        ({"axes": [{"name": "Heartbeat"}]}, "expected another name"),
        ({"axes": []}, "at least 1 item"),
        ({"axes": [{"name": "A.b"}]}, "should match pattern"),
        ({"axes": [{"name": "A", "noise": {"type": "uniform", "half_width": -1}}]}, "greater than or equal to 0"),
        ({"axes": [{"name": "A", "motion": {"type": "trapezium"}}]}, "expected tags"),
        (
            {
                "axes": [
                    {"name": "A", "motion": {"type": "trapezoid", "distance": 0, "velocity": 1, "acceleration": 1}}
                ]
            },
            "an axis at rest is type: constant",
        ),
        ({"period": 50}, "Extra inputs are not permitted"),
        ({"seed": -1}, "greater than or equal to 0"),
    ],
)
def test_a_wrong_scenario_is_refused_with_what_was_found_and_what_is_right(fields: dict[str, Any], said: str):
    whole = {"axes": [{"name": "AxisX"}], "modbus": {"port": 0}} | fields

    with pytest.raises(ValidationError, match=said):
        Scenario.model_validate_json(json.dumps(whole))


def test_the_example_is_the_papers_experiment_on_two_axes_and_two_protocols():
    file = Path(__file__).parent.parent.parent / "config" / "scenario.yaml"
    chosen = Scenario.model_validate_json(json.dumps(YAML(typ="safe").load(file)))

    assert chosen.period_ms == 50.0
    assert [axis.motion for axis in chosen.axes] == [RampHold(type="ramp_hold")] * 2
    assert [axis.noise for axis in chosen.axes] == [UniformNoise(type="uniform")] * 2
    assert chosen.opcua is not None and chosen.opcua.port == 4841
    assert chosen.modbus is not None and chosen.modbus.port == 5021
