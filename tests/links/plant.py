"""Axes of softplc over an OPC-UA server whose samples a test makes up, status, value, stamp and all."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

from asyncua import ua

from softplc.app.layout import build_layout
from softplc.config.models import Config
from softplc.scan import CyclicTask
from softplc.timing import Scan
from tests.chaos.rig import running
from tests.drivers_opcua.servers import AsyncuaPlc

PERIOD = 0.05
PATIENCE = 30.0


class Shown(NamedTuple):
    """An axis in one scan."""

    raw: float
    raw_status: int
    position: float
    status: int
    velocity: float
    reason: int
    quality: int
    dt: float
    stamp: int  # of Position
    start: float  # of the scan


class Plant:
    """One axis for each name of the server's variables; `shown` is the last scan, `history` all of them, by axis."""

    def __init__(self, task: CyclicTask, config: Config, keep: bool) -> None:
        self.task = task
        blocks = build_layout(config).table.blocks
        leaves = ("Raw", "Position", "Velocity", "Reason", "Quality", "Dt")
        self._places = {b.name: [b.index(leaf) for leaf in leaves] for b in blocks if b.kind == "axis"}
        self.index = {tag.name: block.start + n for block in blocks for n, tag in enumerate(block.tags)}
        self.history: dict[str, list[Shown]] = {name: [] for name in self._places}
        self.shown: dict[str, Shown] = {}
        self._keep = keep
        self._scanned = asyncio.Event()
        task.on_scan = self._on_scan

    def value(self, tag: str) -> float:
        return float(self.task.outputs.values[self.index[tag]])

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, f"not within {PATIENCE:g} s: {what}"
            await self.scan()

    async def scan(self) -> None:
        """Return after the next scan."""
        self._scanned.clear()
        await self._scanned.wait()

    def _on_scan(self, scan: Scan) -> None:
        values, statuses = self.task.outputs.values, self.task.outputs.statuses
        stamps = self.task.outputs.source_timestamps
        for name, (raw, position, velocity, reason, quality, dt) in self._places.items():
            self.shown[name] = Shown(
                float(values[raw]),
                int(statuses[raw]),
                float(values[position]),
                int(statuses[position]),
                float(values[velocity]),
                int(values[reason]),
                int(values[quality]),
                float(values[dt]),
                int(stamps[position]),
                scan.start,
            )
            if self._keep:
                self.history[name].append(self.shown[name])
        self._scanned.set()


@asynccontextmanager
async def plant(
    plc: AsyncuaPlc,
    names: Sequence[str],
    mode: str,
    keep: bool = False,
    source: dict[str, Any] | None = None,
    own: dict[str, dict[str, Any]] | None = None,
    **axis: Any,
) -> AsyncIterator[Plant]:
    """Axes over these variables of the server, all with these settings."""
    observer = {"type": "aoi", "q_x": 0.001, "q_x_dot": 0.5, "r_x": 0.01}
    document = {
        "tasks": [{"name": "main", "period_ms": PERIOD * 1000.0}],
        "sources": [
            {
                "type": "opcua",
                "name": "plc",
                "url": plc.url,
                "mode": mode,
                "timeout_ms": 20_000,
                "stale_after_ms": 20_000,
                **(source or {}),
            }
        ],
        "axes": [
            {
                "name": name,
                "input": {"source": "plc", "node": f"ns={plc.index};s={name}"},
                "observer": observer,
                **axis,
                **(own or {}).get(name, {}),
            }
            for name in names
        ],
        "publishers": [],
    }
    config = Config.model_validate_json(json.dumps(document))
    async with running(config) as task:
        yield Plant(task, config, keep)


async def add(plc: AsyncuaPlc, names: Sequence[str]) -> None:
    """Variables for numbers (Double) of any status."""
    folder = plc.server.nodes.objects
    for name in names:
        await folder.add_variable(ua.NodeId(name, plc.index), f"{plc.index}:{name}", 0.0, ua.VariantType.Double)


def number(value: float | None, status: int = 0, **more: Any) -> ua.DataValue:
    variant = None if value is None else ua.Variant(value, ua.VariantType.Double)
    return ua.DataValue(variant, ua.StatusCode(status), **more)
