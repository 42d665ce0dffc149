"""The fixed offsets within the blocks of a task, a source and an axis, by the last part of the tag's name.

A tag that is added later takes an offset that was free; no offset that was ever given moves. Leaves that never meet
on one axis, as the tuning of different observers, may share an offset. What a PLC or a panel does not need, and what
would not fit, has no register: it is on the OPC-UA server alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from softplc.publishers.modbus.placement import AXES, SOURCES, TASKS, Area
from softplc.publishers.modbus.rows import Origin, RegisterType


@dataclass(frozen=True, slots=True)
class Derived:
    """A register that is no tag of its own but is worked out from one."""

    offset: int
    leaf: str
    type: RegisterType
    unit: str
    description: str
    origin: Origin
    of: str  # leaf of the tag that it is worked out from


@dataclass(frozen=True, slots=True)
class Frame:
    """The fixed offsets of one kind of block, its derived registers, and the offsets that are free for other tags.

    `absent`: leaves without a register.
    """

    area: Area
    offsets: Mapping[str, int]
    derived: tuple[Derived, ...]
    free: range
    absent: frozenset[str] = frozenset()


_U16, _U32 = RegisterType.UINT16, RegisterType.UINT32

TASK: Final = Frame(
    TASKS,
    {
        "Heartbeat": 0,
        "ScanNumber": 2,
        "Overruns": 4,
        "Overloaded": 6,
        "CommandsRefused": 8,
        "Period": 10,
        "Dt": 12,
        "Jitter": 14,
        "ExecutionTime": 16,
        "Suspended": 18,
        "DtP50": 20,
        "DtP95": 22,
        "DtP99": 24,
        "DtMax": 26,
        "JitterP50": 30,
        "JitterP95": 32,
        "JitterP99": 34,
        "JitterMax": 36,
        "ExecutionP50": 40,
        "ExecutionP95": 42,
        "ExecutionP99": 44,
        "ExecutionMax": 46,
    },
    (Derived(1, "Alive", _U16, "", "1 while the task scans, 0 when it stands still", Origin.ALIVE, "Heartbeat"),),
    range(50, 100),
)
SOURCE: Final = Frame(
    SOURCES,
    {
        "Connected": 0,
        "OffScan": 1,
        "Reads": 2,
        "ReadErrors": 4,
        "Reconnects": 6,
        "Writes": 8,
        "WriteErrors": 10,
        "ReadTime": 12,
        "Age": 14,
        "Heartbeat": 19,
    },
    (),
    range(16, 19),
    frozenset({"WriteMismatches", "Skew", "SlowPath"}),
)
AXIS: Final = Frame(
    AXES,
    {
        "Position": 0,
        "Velocity": 2,
        "Raw": 4,
        "Innovation": 6,
        "S": 8,
        "K0": 10,
        "K1": 12,
        "P00": 14,
        "P01": 16,
        "P11": 18,
        "NIS": 20,
        "Dt": 22,
        "Age": 24,
        # 26: what one observer estimates beside the others
        "Acceleration": 26,
        "Cutoff": 26,
        "Impacts": 26,
        "NISMean": 28,
        "Outside": 30,
        # 32…41 and 46: tuning; an axis has one observer, so each may use them all
        "q_x": 32,
        "q_x_dot": 34,
        "r_x": 36,
        "BleedThresh": 38,
        "BleedFactor": 40,
        "BleedEnable": 46,
        "Q": 34,
        "R": 36,
        "Band": 38,
        "Restitution": 40,
        "Contact": 46,
        "top_speed": 32,
        "top_acceleration": 34,
        "q_x_ddot": 38,
        "q_jerk": 32,
        "window": 32,
        "cycle": 32,
        "alpha": 32,
        "beta": 34,
        "sigma_w": 32,
        "sigma_v": 34,
        "min_cutoff": 32,
        "cutoff_slope": 34,
        "d_cutoff": 36,
        # state and commands
        "Quality": 42,
        "Reason": 43,
        "Enabled": 44,
        "Enable": 45,
        # consistency, shadow, innovation gate
        "Autocorrelation": 50,
        "PositionDelta": 52,
        "VelocityDelta": 54,
        "PositionDeltaMax": 56,
        "VelocityDeltaMax": 58,
        "Rejected": 60,
        "Consistency": 62,
        "State": 63,
    },
    (
        Derived(47, "AgeMs", _U16, "ms", "Age in whole ms; 65535 when longer or unknown", Origin.MILLISECONDS, "Age"),
        Derived(48, "Status", _U32, "", "OPC UA StatusCode of the position", Origin.STATUS, "Position"),
    ),
    range(50, 64),
    frozenset(
        {"K2", "P02", "P12", "P22", "LowerStop", "UpperStop", "Skipped", "Reset"}
        | {"PositionNow", "VelocityNow", "Horizon", "WriteState"}
        | {"min_r", "GateSigma", "GateMost", "BleedOn", "BleedVelocity"}
        | {"HoldProbability", "CruiseProbability", "ManoeuvreProbability"}
        | {"NISLow", "NISHigh", "AutocorrelationMax", "AutocorrelationLimit", "MinEigenvalue", "CovarianceValid"}
    ),
)
FRAMES: Final = {"task": TASK, "source": SOURCE, "axis": AXIS}
"""Kind of block (`softplc.tags.Block.kind`) → its frame, in order of address."""
