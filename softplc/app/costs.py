"""What the parts of a scan cost, as linear models, all in µs: docs/limits.md says which are medians of
`python3 dev.py bench budget`, which are rounded from them, and which are estimates.
"""

from dataclasses import dataclass
from typing import Final

MACHINE: Final = "a busy virtual machine with 2 cores and Python 3.11"


@dataclass(frozen=True, slots=True)
class Cost:
    """`once` for each one, and `each` for every tag or axis in it, µs."""

    once: float
    each: float

    def of(self, count: int) -> float:
        """For so many, µs."""
        return self.once + self.each * count


@dataclass(frozen=True, slots=True)
class Costs:
    """Our own share and a device's: `device` is what the peer of the measurement took to answer, on the same machine.

    A request of OPC-UA is one Read of many tags, one of Modbus at most 125 registers; `modbus_turn` is for as many of
    those as may be in flight, and `modbus_device` for what they wait together. `observers` by type, for a
    scan of all axes of one observer, its tags written. `subscribed` is for each change of a value, beside
    a message in every scan.
    """

    scan: float
    publish: Cost
    opcua: Cost
    opcua_device: Cost
    modbus: Cost
    modbus_turn: float
    modbus_device: Cost
    replay: Cost
    subscribed: float
    observers: dict[str, Cost]


MEASURED: Final = Costs(
    scan=300.0,
    publish=Cost(3.0, 0.002),
    opcua=Cost(380.0, 0.17),
    opcua_device=Cost(1000.0, 14.0),
    modbus=Cost(5.0, 0.2),
    modbus_turn=40.0,
    modbus_device=Cost(325.0, 0.0),
    replay=Cost(10.0, 1.0),
    subscribed=0.5,
    observers={
        "adaptive": Cost(140.0, 5.7),
        "alpha_beta": Cost(130.0, 0.13),
        "aoi": Cost(180.0, 0.22),
        "cv_accel": Cost(190.0, 0.23),
        "derivative": Cost(81.0, 0.061),
        "dhvpo": Cost(130.0, 0.13),
        "ducekf": Cost(200.0, 0.23),
        "end_stops": Cost(200.0, 0.23),
        "fb_kalman": Cost(130.0, 0.16),
        "finite_difference": Cost(70.0, 0.058),
        "moving_average": Cost(89.0, 0.26),
        "one_euro": Cost(82.0, 0.078),
    },
)
