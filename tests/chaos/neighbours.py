"""One silent device beside nine healthy ones, in a task of its own."""

import asyncio
import json
from typing import Any

import numpy as np

from softplc.app.layout import build_layout
from softplc.config.models import Config
from softplc.sample import StatusCode
from softplc.timing import Scan
from tests.chaos.rig import PATIENCE, PERIOD, running
from tests.support.proxy import Mode, Proxy

DEVICES = 10


async def neighbours(rig: Any, size: Any) -> str:
    """Ten Modbus sources; the last one, behind a proxy, falls silent."""
    async with Proxy(rig.modbus.port) as proxy:
        ports = [rig.modbus.port] * (DEVICES - 1) + [proxy.port]
        config = _config(ports)
        table = build_layout(config).table
        raws = [table.index(f"Axis{number}.Raw") for number in range(DEVICES)]
        off = table.index(f"Sources.device{DEVICES - 1}.OffScan")
        reads = [table.index(f"Sources.device{number}.Reads") for number in range(DEVICES)]
        seen: list[tuple[list[int], list[float], float, float, int]] = []
        async with running(config) as task:
            scanned = asyncio.Event()

            def look(scan: Scan) -> None:
                statuses = [int(task.outputs.statuses[raw]) for raw in raws]
                counts = [float(task.outputs.values[index]) for index in reads]
                execution = task.clock.monotonic() - scan.start
                seen.append((statuses, counts, execution, float(task.outputs.values[off]), scan.overruns))
                scanned.set()

            task.on_scan = look

            async def scans(number: int) -> list[Any]:
                start = len(seen)
                async with asyncio.timeout(PATIENCE):
                    while len(seen) < start + number:
                        scanned.clear()
                        await scanned.wait()
                return seen[start:]

            async with asyncio.timeout(PATIENCE):
                while not seen or any(seen[-1][0]):
                    await scans(1)
            n = 200 if size.strict else 20
            before = await scans(n)
            await proxy.switch(Mode.STALL)
            during = await scans(n)
            await proxy.switch(Mode.PASS)

    def rate(part: list[Any]) -> float:
        """Reads in each scan and healthy device."""
        return float(
            np.mean([(b - a) / (len(part) - 1) for a, b in zip(part[0][1][:-1], part[-1][1][:-1], strict=True)])
        )

    def good(part: list[Any]) -> float:
        return float(np.mean([[status == StatusCode.GOOD for status in each[0][:-1]] for each in part]))

    def execution(part: list[Any]) -> str:
        p50, p99 = np.percentile([each[2] for each in part], (50, 99)) * 1e3
        return f"{p50:.1f}/{p99:.1f} ms"

    assert all(each[0][-1] != StatusCode.GOOD for each in during[1:]), "the silent device is Good"
    assert any(each[3] for each in during), "the silent device stays in the scan"
    # what this machine does to them beside is seen before; a tenth is for its moods
    assert rate(during) >= rate(before) - 0.1, f"{rate(before):.2f} → {rate(during):.2f} reads in each scan"
    assert good(during) >= good(before) - 0.1, f"{good(before):.1%} → {good(during):.1%} Good"
    return (
        f"neighbours Good {good(before):.1%} → {good(during):.1%}, reads in each scan {rate(before):.2f} → "
        f"{rate(during):.2f}; scan p50/p99 {execution(before)} → {execution(during)}"
    )


def _config(ports: list[int]) -> Config:
    sources = [
        {"type": "modbus", "name": f"device{number}", "transport": {"host": "127.0.0.1", "port": port}}
        for number, port in enumerate(ports)
    ]
    axes = [
        {
            "name": f"Axis{number}",
            "input": {"source": f"device{number}", "address": "holding:10", "data_type": "float64"},
            "observer": {"type": "aoi", "r_x": 1.0},
        }
        for number in range(len(ports))
    ]
    tasks = [{"name": "main", "period_ms": PERIOD * 1e3}]
    document = {"tasks": tasks, "sources": sources, "axes": axes, "publishers": []}
    return Config.model_validate_json(json.dumps(document))
