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
        "Period": 10,
        "Dt": 12,
        "Jitter": 14,
        "ExecutionTime": 16,
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
        "Reads": 2,
        "ReadErrors": 4,
        "Reconnects": 6,
        "Writes": 8,
        "WriteErrors": 10,
        "ReadTime": 12,
        "Age": 14,
    },
    (),
    range(16, 20),
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
        "Age": 24,  # 26 and 27 are kept for an estimate to come
        "Rejected": 28,
        "Skipped": 30,
        "q_x": 32,
        "q_x_dot": 34,
        "r_x": 36,
        "Q": 34,
        "R": 36,
        "BleedThresh": 38,
        "BleedFactor": 40,
        "Quality": 42,
        "Reason": 43,
        "Enabled": 44,
        "Enable": 45,
        "BleedEnable": 46,
    },
    (
        Derived(47, "AgeMs", _U16, "ms", "Age in whole ms; 65535 when longer or unknown", Origin.MILLISECONDS, "Age"),
        Derived(48, "Status", _U32, "", "OPC UA StatusCode of the position", Origin.STATUS, "Position"),
    ),
    range(50, 64),
    frozenset({"min_r", "GateSigma", "GateMost", "BleedOn", "BleedVelocity"}),
)
FRAMES: Final = {"task": TASK, "source": SOURCE, "axis": AXIS}
"""Kind of block (`softplc.tags.Block.kind`) → its frame, in order of address."""
