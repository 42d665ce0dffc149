"""A task of softplc in a process whose wall clock somebody steps: one line of JSON for each scan.

Usage: python -m tests.links.stepped CONFIG, as JSON; until it is ended.

libfaketime shifts the deadlines of a timerfd by the wall clock's offset, also on CLOCK_MONOTONIC, as no kernel does.
So the event loop's own timer wakes the scans here, as it does where there is no timerfd.
"""

import asyncio
import json
import sys

import structlog

from softplc import clock
from softplc.app.layout import build_layout
from softplc.config.models import Config
from softplc.timing import Scan
from tests.chaos.rig import running


async def main(config: Config) -> None:
    blocks = build_layout(config).table.blocks
    axes = [(block.index("Position"), block.index("Dt")) for block in blocks if block.kind == "axis"]
    links = [block for block in blocks if block.kind == "source"]
    async with running(config) as task:

        def tell(scan: Scan) -> None:
            outputs = task.outputs
            line = {
                "dt": scan.dt,
                "timestamp": scan.timestamp,
                "status": [int(outputs.statuses[position]) for position, _ in axes],
                "stamp": [int(outputs.source_timestamps[position]) for position, _ in axes],
                "axis_dt": [float(outputs.values[dt]) for _, dt in axes],
                "reconnects": [float(outputs.values[link.index("Reconnects")]) for link in links],
                "read_errors": [float(outputs.values[link.index("ReadErrors")]) for link in links],
            }
            sys.stdout.write(json.dumps(line) + "\n")
            sys.stdout.flush()

        task.on_scan = tell
        await asyncio.get_running_loop().create_future()


if __name__ == "__main__":
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    clock._open_alarm = clock._LoopTimer
    asyncio.run(main(Config.model_validate_json(sys.argv[1])))
