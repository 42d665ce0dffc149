"""What one machine carries today: softplc and its emulated PLC with N axes over OPC-UA, over Modbus.

Usage: python bench/end_to_end.py [--axes 10 100 400] [--seconds 10] [--period-ms 50]
Starts the real commands (`softplc emulate`, `softplc run`) for each N and protocol, and reads softplc's own
statistics over Modbus. Times in ms, CPU in per cent of one core and memory in MiB for the scan process and for the
gateway.
"""

import argparse
import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from softplc.publishers.modbus.offsets import TASK
from softplc.publishers.modbus.placement import TASKS

_TICKS = os.sysconf("SC_CLK_TCK")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start(command: str, document: dict[str, Any], folder: Path) -> tuple["subprocess.Popen[str]", dict[str, Any]]:
    """Start a command on a configuration; JSON is YAML too. Returns the process and its ready document."""
    path = folder / f"{command}.yaml"
    path.write_text(json.dumps(document))
    process = subprocess.Popen(
        [sys.executable, "-m", "softplc", command, str(path), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    lines: list[str] = []
    for line in process.stdout:
        lines.append(line)
        if line == "}\n":
            return process, json.loads("".join(lines))
    raise SystemExit(f"softplc {command} ended with exit code {process.wait()}")


def scenario(n: int, ports: dict[str, int], period_ms: float) -> dict[str, Any]:
    axis = {"unit": "mm", "motion": {"type": "ramp_hold", "slope": 10, "segment_s": 15}}
    noise = {"noise": {"type": "uniform", "half_width": 2}}
    return {
        "period_ms": period_ms,
        "seed": 1,
        "axes": [{"name": f"A{k}", **axis, **noise} for k in range(n)],
        "opcua": {"host": "127.0.0.1", "port": ports["plc opcua"]},
        "modbus": {"host": "127.0.0.1", "port": ports["plc modbus"]},
    }


def configuration(n: int, protocol: str, ports: dict[str, int], period_ms: float) -> dict[str, Any]:
    if protocol == "opcua":
        source = {"type": "opcua", "name": "plc", "url": f"opc.tcp://127.0.0.1:{ports['plc opcua']}"}
        inputs = [{"source": "plc", "node": f"ns=2;s=A{k}.Position"} for k in range(n)]
    else:
        transport = {"type": "tcp", "host": "127.0.0.1", "port": ports["plc modbus"]}
        source = {"type": "modbus", "name": "plc", "transport": transport, "max_gap": 20}
        inputs = [{"source": "plc", "address": f"holding:{100 + 20 * k}"} for k in range(n)]
    observer = {"type": "aoi", "q_x": 0.01, "q_x_dot": 0.1, "r_x": 1.3333}
    return {
        "tasks": [{"name": "main", "period_ms": period_ms}],
        "sources": [source],
        "axes": [{"name": f"A{k}", "unit": "mm", "input": inputs[k], "observer": observer} for k in range(n)],
        "publishers": [{"type": "opcua", "port": ports["opcua"]}, {"type": "modbus", "port": ports["modbus"]}],
        "log": {"level": "error"},
    }


def task_values(port: int) -> dict[str, float]:
    """The task's statistics over Modbus."""
    first, count = TASKS.start, 50
    with socket.create_connection(("127.0.0.1", port), 5) as connection:
        connection.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, first, count))
        reply = connection.makefile("rb").read(9 + 2 * count)[9:]

    def number(leaf: str, kind: str) -> float:
        return float(struct.unpack_from(kind, reply, 2 * TASK.offsets[leaf])[0])

    doubles = ("ExecutionP50", "ExecutionP99", "JitterP50", "JitterP99")
    values = {leaf: number(leaf, ">f") * 1e3 for leaf in doubles}
    return {**values, "Overruns": number("Overruns", ">I"), "ScanNumber": number("ScanNumber", ">I")}


def processes(parent: int) -> dict[str, int]:
    """Scan process and gateway by name."""
    found = {}
    for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        found[Path(f"/proc/{child}/comm").read_text().strip()] = int(child)
    return found


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def resident(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def measure(n: int, protocol: str, seconds: float, period_ms: float) -> None:
    ports = {use: free_port() for use in ("plc opcua", "plc modbus", "opcua", "modbus")}
    with tempfile.TemporaryDirectory() as folder:
        plc, _ = start("emulate", scenario(n, ports, period_ms), Path(folder))
        begun = time.monotonic()
        try:
            daemon, _ = start("run", configuration(n, protocol, ports, period_ms), Path(folder))
            ready = time.monotonic() - begun
            try:
                time.sleep(5.0)  # connected, frozen, warm
                pids = processes(daemon.pid)
                before, cpu = task_values(ports["modbus"]), {name: cpu_seconds(pid) for name, pid in pids.items()}
                time.sleep(seconds)
                after = task_values(ports["modbus"])
                used = {name: (cpu_seconds(pid) - cpu[name]) / seconds * 100 for name, pid in pids.items()}
                missed = after["Overruns"] - before["Overruns"]
                scans = after["ScanNumber"] - before["ScanNumber"]
                print(
                    f"{protocol:<8}{n:>6}{ready:>8.1f}{after['ExecutionP50']:>9.2f}{after['ExecutionP99']:>9.2f}"
                    f"{after['JitterP50']:>9.2f}{after['JitterP99']:>9.2f}{scans:>7.0f}{missed:>8.0f}"
                    f"{used.get('softplc-scan', 0):>7.0f}{used.get('softplc-gateway', 0):>9.0f}"
                    f"{resident(pids['softplc-scan']):>8.0f}{resident(pids['softplc-gateway']):>9.0f}",
                    flush=True,
                )
            finally:
                daemon.terminate()
                daemon.wait(10)
        finally:
            plc.terminate()
            plc.wait(10)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, nargs="+", default=[10, 100, 400])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--period-ms", type=float, default=50.0)
    options = parser.parse_args()
    print(f"period {options.period_ms:g} ms, {os.cpu_count()} CPUs, emulated PLC on the same machine")
    print(
        f"{'source':<8}{'axes':>6}{'ready s':>8}{'exec p50':>9}{'exec p99':>9}{'jit p50':>9}{'jit p99':>9}"
        f"{'scans':>7}{'missed':>8}{'scan %':>7}{'gateway %':>9}{'MiB':>8}{'MiB':>9}"
    )
    for n in options.axes:
        for protocol in ("modbus", "opcua"):
            measure(n, protocol, options.seconds, options.period_ms)


if __name__ == "__main__":
    main()
