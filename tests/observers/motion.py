"""A ramp in every way that samples come: each scan, at the source's own period, or not at all."""

import itertools
import math

from softplc.observers.axes import AxisSpec, DtSource, OnRepeat
from tests.observers.rig import Rig

SPEED = 10.0  # u/s, of the ramps here
DT_SOURCES: tuple[DtSource, ...] = ("scan", "source", "arrival")
ON_REPEATS: tuple[OnRepeat, ...] = ("update", "predict")
MODES = list(itertools.product(DT_SOURCES, ON_REPEATS))


def axis(dt_source: DtSource = "scan", on_repeat: OnRepeat = "update", **more: float) -> AxisSpec:
    return AxisSpec("A0", dt_source=dt_source, on_repeat=on_repeat, **more)  # type: ignore[arg-type]


def ramp(rig: Rig, seconds: float) -> None:
    """A new sample in every scan."""
    for _ in range(round(seconds / rig.period)):
        rig.scan(SPEED * rig.next)


def follow(rig: Rig, seconds: float, source_period: float, phase: float = 0.001) -> list[float]:
    """Scans of a source that takes a sample of the ramp every `source_period`; the velocities of the second half.

    The source stamps its samples as it takes them; a subscription brings each as it is taken.
    """
    velocities = []
    scans = round(seconds / rig.period)
    for k in range(scans):
        taken = math.floor((rig.next - phase) / source_period) * source_period + phase
        rig.scan(SPEED * taken, stamp=taken, arrival=taken)
        if k >= scans // 2:
            velocities.append(rig.get("Velocity"))
    return velocities
