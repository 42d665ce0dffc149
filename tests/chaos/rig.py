"""A task of softplc's between third-party PLCs, each source behind a proxy, and a record of what it published."""

import asyncio
import json
import os
import signal
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from softplc.app.layout import build_layout
from softplc.app.process import SPAWN
from softplc.app.scan_process import build_tasks, start_tasks
from softplc.clock import SystemClock, monotonic
from softplc.config.models import Config
from softplc.emulator.run import run_emulator
from softplc.emulator.scenario import Scenario
from softplc.exchange import Writer, size
from softplc.sample import StatusCode
from softplc.scan import CyclicTask
from softplc.timing import Scan
from tests.drivers_modbus.support import running_peer
from tests.drivers_opcua.servers import URI, NodePlc
from tests.support.proxy import Mode, Proxy

PERIOD: Final = 0.05
KINDS: Final = ("poll", "subscribe", "modbus")
RATE: Final = 10.0  # units per second of every PLC's clock tag
_WRAP: Final = 10_000.0  # seconds after which it starts again
PATIENCE: Final = 60.0  # seconds until something that has to come is given up


class Seen(NamedTuple):
    """One axis in one scan; `start` in monotonic seconds."""

    start: float
    good: bool
    raw: float
    raw_status: int
    velocity: float
    velocity_status: int
    age: float  # seconds from the making of the raw value in the PLC to the start of this scan; NaN without value


class OurPlc:
    """softplc's own emulator: a ramp of RATE over OPC-UA and Modbus, in one process."""

    def __init__(self) -> None:
        axis = {"name": "AxisX", "motion": {"type": "ramp_hold", "slope": RATE, "segment_s": 8e4}}
        axis["noise"] = {"type": "none"}
        document = {"period_ms": 20, "axes": [axis], "opcua": {"port": 0}, "modbus": {"port": 0}}
        ours, theirs = SPAWN.Pipe(duplex=False)
        scenario = Scenario.model_validate_json(json.dumps(document))
        self._process = SPAWN.Process(target=run_emulator, args=(scenario, theirs), daemon=True)
        self._process.start()
        state, endpoints = ours.recv()
        assert state == "ready", endpoints
        self.port, self.modbus = (int(endpoints[name].rpartition(":")[2]) for name in ("opcua", "modbus"))

    @property
    def pid(self) -> int:
        return self._process.pid

    def close(self) -> None:
        self._process.kill()
        self._process.join()


@dataclass
class Rig:
    """One source of each kind; proxies, links and records by kind.

    `tells_time`: the values tell when the PLC made them; without that their age counts as 0.
    """

    opcua: Any
    modbus: Any
    tells_time: bool
    proxies: dict[str, Proxy]
    task: CyclicTask
    axes: dict[str, tuple[int, int, int]]
    folder: Path
    seen: dict[str, list[Seen]] = field(default_factory=dict)
    scans: list[Scan] = field(default_factory=list)
    _scanned: asyncio.Event = field(default_factory=asyncio.Event)

    def links(self, kind: str) -> Any:
        return next(place.link for place in self.task.links if place.link.name == kind)

    def on_scan(self, scan: Scan) -> None:
        self.scans.append(scan)
        outputs = self.task.outputs
        for kind, (raw, position, velocity) in self.axes.items():
            value, status = float(outputs.values[raw]), int(outputs.statuses[raw])
            age = (scan.timestamp / 1e9 - value / RATE) % _WRAP if self.tells_time else 0.0
            self.seen[kind].append(
                Seen(
                    scan.start,
                    int(outputs.statuses[position]) == StatusCode.GOOD,
                    value,
                    status,
                    float(outputs.values[velocity]),
                    int(outputs.statuses[velocity]),
                    age - _WRAP if age > _WRAP / 2 else age,
                )
            )
        self._scanned.set()
        self._scanned = asyncio.Event()

    async def until(self, condition: Callable[[], bool], what: str) -> None:
        """Return after the scan in which the condition holds."""
        try:
            async with asyncio.timeout(PATIENCE):
                while not condition():
                    await self._scanned.wait()
        except TimeoutError:
            raise AssertionError(f"not within {PATIENCE:g} s: {what}") from None

    async def rest(self, seconds: float) -> None:
        """Let scans go on for so long."""
        until = monotonic() + seconds
        while monotonic() < until:
            await self._scanned.wait()

    async def good(self, kind: str, since: float | None = None, scans: int = 1) -> float:
        """Start of the first of so many Good scans in a row that start after `since`."""
        after = monotonic() if since is None else since

        def run() -> list[Seen]:
            last = self.seen[kind][-scans:]
            return last if len(last) == scans and all(s.good and s.start >= after for s in last) else []

        await self.until(lambda: bool(run()), f"{kind} is Good again; it is {self.seen[kind][-1:]}")
        return run()[0].start

    async def all_good(self) -> None:
        """Every source's output was Good in several scans in a row: the last fault is over."""
        await asyncio.gather(*(self.good(kind, scans=3) for kind in self.axes))

    async def switch(self, mode: Mode, kinds: Iterable[str] = KINDS) -> float:
        """All proxies to this mode; the monotonic time of it."""
        for kind in kinds:
            await self.proxies[kind].switch(mode)
        return monotonic()

    def since(self, start: float, kind: str) -> list[Seen]:
        """What the axis showed in scans that started at `start` or after."""
        return [seen for seen in self.seen[kind] if seen.start >= start]

    def signal(self, number: signal.Signals) -> None:
        """To both PLCs."""
        for pid in {self.opcua.pid, self.modbus.pid}:
            os.kill(pid, number)

    async def replace_opcua(self, **options: Any) -> None:
        """Kill the OPC-UA server and start it anew on its port, other than it was."""
        self.opcua.kill()
        self.opcua.close()
        self.opcua = await asyncio.to_thread(NodePlc, self.folder, self.opcua.port, **options)

    def stale(self, kind: str, start: float, limit: float) -> list[Seen]:
        """Scans from `start` on that showed as Good a value that was too old, or that the PLC never had.

        A poll asks in its scan, so its Good values are younger than the scan's start, on whatever machine; the PLCs
        tell whole milliseconds. A subscription's may be up to `limit` seconds old.
        """
        oldest = limit if kind == "subscribe" else 0.002
        return [seen for seen in self.since(start, kind) if seen.good and not -1.0 < seen.age <= oldest]

    def forget(self) -> None:
        """Let go of what was recorded."""
        for seen in (*self.seen.values(), self.scans):
            del seen[:-1]


def config_of(urls: dict[str, str], modbus: int, node: str, address: str, data_type: str) -> Config:
    """A task with one axis for each kind; urls by mode, port of the Modbus source, and where the values are."""
    observer = {"type": "aoi", "q_x": 0.001, "q_x_dot": 0.5, "r_x": 0.01}
    sources: list[dict[str, Any]] = [
        {"type": "opcua", "name": mode, "url": url, "mode": mode} for mode, url in urls.items()
    ]
    sources.append({"type": "modbus", "name": "modbus", "transport": {"host": "127.0.0.1", "port": modbus}})
    inputs: dict[str, dict[str, str]] = {mode: {"source": mode, "node": node} for mode in urls}
    inputs["modbus"] = {"source": "modbus", "address": address, "data_type": data_type}
    document = {
        "tasks": [{"name": "main", "period_ms": PERIOD * 1000.0}],
        "sources": sources,
        "axes": [{"name": name.capitalize(), "input": tag, "observer": observer} for name, tag in inputs.items()],
        "publishers": [],
    }
    return Config.model_validate_json(json.dumps(document))


@asynccontextmanager
async def running(config: Config) -> AsyncIterator[CyclicTask]:
    """The scans and links of a configuration with one task, in this event loop."""
    clock = SystemClock()
    layout = build_layout(config)
    (task,) = build_tasks(layout, Writer(bytearray(size(layout.table)), layout.table), clock)
    async with asyncio.TaskGroup() as group:
        tasks = start_tasks(group, [task])
        yield task
        for each in tasks:
            each.cancel()
    clock.close()


@asynccontextmanager
async def rig(folder: Path) -> AsyncIterator[Rig]:
    """node-opcua read by poll and by subscription, and modbus-serial; all Good."""
    opcua = await asyncio.to_thread(NodePlc, folder)
    made: Rig | None = None
    async with AsyncExitStack() as stack:
        stack.callback(lambda: (made.opcua if made else opcua).close())  # noqa: PLW0108  which one, is known then
        modbus = await stack.enter_async_context(running_peer())
        await modbus.ask("clock", offset=10)
        where = (f"nsu={URI};s=PLC.Axis.Clock", "holding:10", "float64")
        made = await _started(stack, opcua, modbus, modbus.port, folder, where)
        yield made


@asynccontextmanager
async def our_rig(folder: Path) -> AsyncIterator[Rig]:
    """softplc's own emulator as the source, by poll, subscription and Modbus; all Good."""
    plc = await asyncio.to_thread(OurPlc)
    async with AsyncExitStack() as stack:
        stack.callback(plc.close)
        where = ("ns=2;s=AxisX.Position", "holding:100", "float32")
        yield await _started(stack, plc, plc, plc.modbus, folder, where)


async def _started(
    stack: AsyncExitStack, opcua: Any, modbus: Any, modbus_port: int, folder: Path, where: tuple[str, str, str]
) -> Rig:
    targets = {"poll": opcua.port, "subscribe": opcua.port, "modbus": modbus_port}
    proxies = {kind: await stack.enter_async_context(Proxy(port)) for kind, port in targets.items()}
    urls = {kind: f"opc.tcp://127.0.0.1:{proxies[kind].port}" for kind in ("poll", "subscribe")}
    config = config_of(urls, proxies["modbus"].port, *where)
    task = await stack.enter_async_context(running(config))
    axes = {
        block.name.lower(): (block.index("Raw"), block.index("Position"), block.index("Velocity"))
        for block in build_layout(config).table.blocks
        if block.kind == "axis"
    }
    made = Rig(opcua, modbus, opcua is not modbus, proxies, task, axes, folder, {kind: [] for kind in axes})
    task.on_scan = made.on_scan
    await made.all_good()
    return made
