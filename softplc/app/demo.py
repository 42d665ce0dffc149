"""The demo's configuration: the paper's experiment on an emulated PLC, one axis over OPC-UA, one over Modbus."""

import json
from dataclasses import dataclass
from typing import Any, Final

from softplc.app.ports import port_is_free
from softplc.config.models import Config
from softplc.emulator.scenario import Scenario
from softplc.errors import SoftplcError

HOST: Final = "127.0.0.1"
PORTS: Final = {"plc opcua": 4841, "plc modbus": 5021, "opcua": 4840, "modbus": 5020}
_TRIES = 200


@dataclass(frozen=True, slots=True)
class Demo:
    """Configuration and scenario on the same ports, and a note for each wanted port that was taken."""

    config: Config
    scenario: Scenario
    ports: dict[str, int]
    notes: list[str]

    def outrun(self) -> bool:
        """True when somebody else has taken one of the ports since they were chosen."""
        return not all(port_is_free(HOST, port) for port in self.ports.values())


def demo_setup() -> Demo:
    """A demo on free ports. Raises SoftplcError when there are none."""
    ports: dict[str, int] = {}
    notes: list[str] = []
    for use, wanted in PORTS.items():
        ports[use] = _free_port(wanted, taken=set(ports.values()))
        if ports[use] != wanted:
            notes.append(f"port {wanted} ({use}) is taken, using {ports[use]}")
    return Demo(demo_config(ports), demo_scenario(ports), ports, notes)


def demo_config(ports: dict[str, int]) -> Config:
    """The configuration of config/demo.yaml, on these ports."""
    observer = {"type": "aoi", "q_x": 0.01, "q_x_dot": 0.1, "r_x": 1.3333}
    data: dict[str, Any] = {
        "tasks": [{"name": "main", "period_ms": 50}],
        "sources": [
            {"name": "plc_opcua", "type": "opcua", "url": f"opc.tcp://{HOST}:{ports['plc opcua']}"},
            {
                "name": "plc_modbus",
                "type": "modbus",
                "transport": {"type": "tcp", "host": HOST, "port": ports["plc modbus"]},
            },
        ],
        "axes": [
            {
                "name": "AxisX",
                "unit": "mm",
                "range": [-100, 500],
                "input": {"source": "plc_opcua", "node": "ns=2;s=AxisX.Position"},
                "observer": observer,
            },
            {
                "name": "AxisY",
                "unit": "mm",
                "range": [-100, 500],
                "input": {"source": "plc_modbus", "address": "holding:120", "data_type": "float32"},
                "observer": observer,
            },
        ],
        "publishers": [
            {"type": "opcua", "host": HOST, "port": ports["opcua"]},
            {"type": "modbus", "host": HOST, "port": ports["modbus"]},
        ],
    }
    return Config.model_validate_json(json.dumps(data))


def demo_scenario(ports: dict[str, int]) -> Scenario:
    """The scenario of config/scenario.yaml, on these ports."""
    motion = {"type": "ramp_hold", "slope": 10, "segment_s": 15}
    noise = {"type": "uniform", "half_width": 2}
    data = {
        "period_ms": 50,
        "seed": 1,
        "axes": [{"name": name, "unit": "mm", "motion": motion, "noise": noise} for name in ("AxisX", "AxisY")],
        "opcua": {"host": HOST, "port": ports["plc opcua"]},
        "modbus": {"host": HOST, "port": ports["plc modbus"]},
    }
    return Scenario.model_validate_json(json.dumps(data))


def _free_port(wanted: int, taken: set[int]) -> int:
    for port in range(wanted, wanted + _TRIES):
        if port not in taken and port not in set(PORTS.values()) - {wanted} and port_is_free(HOST, port):
            return port
    raise SoftplcError(f"no free port on {HOST} from {wanted} to {wanted + _TRIES - 1}")
