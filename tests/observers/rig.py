"""One group of axes on hand-made images: scans are given sample by sample, tags are read by name."""

from dataclasses import dataclass

import numpy as np

from softplc.interfaces import Observer
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisPlace, AxisSpec, ObserverModel, axis_tags
from softplc.observers.leaves import CONSTANTS, JUDGED, STATE
from softplc.sample import Reason, Sample, StatusCode
from softplc.tags import Image, Role, Tag, TagTable
from softplc.timing import Scan

CONFIG = AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3)
UTC = 1_700_000_000_000_000_000
ESTIMATES = ("Position", "Velocity", "Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS", "Dt")


@dataclass
class Rig:
    """Axes A0, A1, … with inputs 0, 1, …; `now` runs on by each scan's dt. Then enable and contact tag, if any."""

    table: TagTable
    inputs: Image
    outputs: Image
    observer: Observer
    period: float
    now: float = 100.0
    scans: int = 0

    @property
    def next(self) -> float:
        """When the next scan will be, if it comes in time."""
        return self.now + self.period if self.scans else self.now

    def scan(
        self,
        *z: float,
        status: int = StatusCode.GOOD,
        stamp: float | None = None,
        arrival: float | None = None,
        dt: float | None = None,
    ) -> None:
        """One scan; `z` is one value for each axis. Stamps in seconds; left out, everything is new at this instant.

        Without `z` the inputs stay as they are, with what else is given.
        """
        if self.scans:
            self.now += self.period if dt is None else dt
        for axis, value in enumerate(z):
            seconds = self.now if stamp is None else stamp
            sample = Sample(value, status, UTC + round(seconds * 1e9))
            self.inputs.put(axis, sample, self.now if arrival is None else arrival)
        self.step(dt)

    def step(self, dt: float | None = None) -> None:
        self.observer.step(self._scan(dt), self.inputs, self.outputs)
        self.scans += 1

    def park(self) -> None:
        """One scan in which the observer is parked."""
        self.now += self.period
        self.observer.park(self._scan(None), self.outputs)

    def _scan(self, dt: float | None) -> Scan:
        dt = self.period if dt is None else dt
        return Scan(self.scans, self.now, UTC + round(self.now * 1e9), dt, self.period, 0)

    def fail(self, status: int) -> None:
        """One scan in which every input is Bad."""
        self.now += self.period
        self.inputs.fail(status)
        self.step()

    def again(self, status: int = StatusCode.GOOD) -> None:
        """One scan in which nothing new came: same values, stamps and arrivals."""
        self.now += self.period
        self.inputs.statuses[: len(self.table.blocks) - 1] = status
        self.step()

    def get(self, leaf: str, axis: int = 0) -> float:
        return float(self.outputs.values[self.table.index(f"A{axis}.{leaf}")])

    def status(self, leaf: str = "Position", axis: int = 0) -> int:
        return int(self.outputs.statuses[self.table.index(f"A{axis}.{leaf}")])

    def stamp(self, leaf: str = "Position", axis: int = 0) -> float:
        """Source timestamp in seconds on the scale of `now`."""
        return (int(self.outputs.source_timestamps[self.table.index(f"A{axis}.{leaf}")]) - UTC) * 1e-9

    def outcome(self, axis: int = 0) -> tuple[StatusCode, Reason]:
        """Status of the estimates and the reason; checks that they all carry that status and that NaN means Bad."""
        tags = next(block for block in self.table.blocks if block.name == f"A{axis}").tags
        leaves = {tag.name.rpartition(".")[2]: tag for tag in tags}
        good = {leaf for leaf, tag in leaves.items() if leaf in STATE + CONSTANTS or tag.role is Role.TUNING}
        statuses = {self.status(leaf, axis) for leaf in leaves.keys() - good - {"Raw", *JUDGED}}
        assert len(statuses) == 1
        status = statuses.pop()
        for leaf in leaves.keys() - good:
            assert np.isnan(self.get(leaf, axis)) == (self.status(leaf, axis) >= StatusCode.BAD), leaf
        for leaf in good:
            assert (self.status(leaf, axis), np.isnan(self.get(leaf, axis))) == (StatusCode.GOOD, False), leaf
        assert self.get("Quality", axis) == max(2 - (status >> 30), 0)
        return StatusCode(status), Reason(int(self.get("Reason", axis)))


def make_rig(
    *axes: AxisSpec | tuple[AxisSpec, ObserverModel],
    period: float = 0.05,
    enable_tag: bool = False,
    contact_tag: bool = False,
    shadow_tags: bool = False,
    shadow_dt: bool = True,
    scattered: bool = False,
) -> Rig:
    """A rig for these axes (one plain axis when none is given), all with observers of the same type.

    `shadow_tags`: each axis also has inputs for the PLC's own position, velocity and time step, behind all others;
    `shadow_dt`: the last of them is used.
    `scattered` puts other tags between their blocks.
    """
    pairs = [axis if isinstance(axis, tuple) else (axis, CONFIG) for axis in axes or (AxisSpec("A0"),)]
    table = TagTable()
    table.add_block("main", "task", [Tag("Tasks.main.Heartbeat")])
    places = []
    for row, (spec, config) in enumerate(pairs):
        block = table.add_block(spec.name, "axis", axis_tags(spec, config))
        enable, contact = len(pairs) if enable_tag else None, len(pairs) + enable_tag if contact_tag else None
        last = len(pairs) + enable_tag + contact_tag + 3 * row
        shadow = (last, last + 1, last + 2 if shadow_dt else None) if shadow_tags else (None, None, None)
        places.append(AxisPlace(spec, row, enable, block, contact, *shadow))
        if scattered:
            table.add_block(f"between{row}", "axis", [Tag(f"between{row}.x"), Tag(f"between{row}.y")])
    table.close_section("main")
    observer = pairs[0][1].build(places, [config for _, config in pairs])
    return Rig(
        table,
        Image(len(pairs) + enable_tag + contact_tag + 3 * shadow_tags * len(pairs)),
        Image(len(table)),
        observer,
        period,
    )
