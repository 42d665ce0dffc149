"""Whatever a source and its clocks may deliver, drawn scan by scan, and the good second after it."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from softplc.sample import Reason, StatusCode
from tests.observers.rig import UTC, Rig

LIMITS = (-1000.0, 1000.0)
_VALUES = st.one_of(
    st.floats(*LIMITS), st.sampled_from([np.nan, np.inf, -np.inf, 1e6, -1e308, 1e308, 1000.0, -0.0, 5e-324])
)
_STATUSES = (
    StatusCode.GOOD,
    StatusCode.GOOD,
    StatusCode.GOOD,
    StatusCode.UNCERTAIN,
    StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    StatusCode.BAD_SENSOR_FAILURE,
    StatusCode.BAD_NO_COMMUNICATION,
)


@dataclass(frozen=True)
class Fault:
    """One scan: what each axis reads, and how the clocks behave. `enable` goes to axes with a writable Enable."""

    z: tuple[float, ...]
    status: int
    stamp: int
    arrival: float
    dt: float
    enable: bool


def faults(axes: int) -> st.SearchStrategy[Fault]:
    """One scan of so many axes."""
    return st.builds(
        Fault,
        z=st.tuples(*[_VALUES] * axes),
        status=st.sampled_from(_STATUSES),
        stamp=st.one_of(st.sampled_from([0, UTC, UTC + 10**18, -(2**63), 2**63 - 1]), st.integers(UTC, UTC + 10**10)),
        arrival=st.one_of(st.floats(90.0, 110.0), st.just(np.nan)),
        dt=st.sampled_from([0.05, 0.05, 0.05, 0.0, -1.0, np.nan, 1e-9, 10.0]),
        enable=st.sampled_from([True, True, True, False]),
    )


def apply(rig: Rig, fault: Fault) -> None:
    """One scan; a Bad input has no value, as the image promises."""
    rig.now += 0.05
    bad = fault.status >= StatusCode.BAD
    rig.inputs.values[:] = np.nan if bad else fault.z
    rig.inputs.statuses[:] = fault.status
    rig.inputs.source_timestamps[:] = fault.stamp
    rig.inputs.arrivals[:] = fault.arrival
    _enable(rig, fault.enable)
    rig.step(fault.dt)


BACK = (StatusCode.GOOD, Reason.NONE)
FAR_OFF = (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.FAR_OFF)


def assert_back(rig: Rig, ranged: int = 3) -> None:
    """The first axes, which have a range, are Good again; one that takes any number may say that it is not."""
    for axis in range(4):
        assert rig.outcome(axis) in ((BACK,) if axis < ranged else (BACK, FAR_OFF)), axis


def good(rig: Rig, scans: int, value: float = 7.0) -> None:
    """Scans of one value with everything in order."""
    _enable(rig, True)
    for k in range(scans):
        rig.now += 0.05
        rig.inputs.values[:] = value
        rig.inputs.statuses[:] = StatusCode.GOOD
        rig.inputs.source_timestamps[:] = UTC + 2 * 10**10 + k * 50_000_000
        rig.inputs.arrivals[:] = 200.0 + 0.05 * k
        rig.step()


def _enable(rig: Rig, on: bool) -> None:
    for block in rig.table.blocks:
        if block.kind == "axis" and f"{block.name}.Enable" in {tag.name for tag in block.tags}:
            rig.observer.command(rig.table.index(f"{block.name}.Enable"), float(on))
