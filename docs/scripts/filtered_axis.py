"""Draws docs/img/filtered-axis.png from a real run: demo started, softplc and emulated PLC read over Modbus.

Usage: .venv/bin/python docs/scripts/filtered_axis.py [--seconds 38] [--output docs/img/filtered-axis.png]
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from pymodbus.client import ModbusTcpClient

mpl.use("agg")
from matplotlib import pyplot as plt

SOFTPLC_AXIS = {"Position": 0, "Velocity": 2, "Raw": 4}  # offsets in the axis block, docs/modbus-map.md


def floats(client: ModbusTcpClient, address: int, count: int) -> np.ndarray:
    """`count` float32 values from input registers."""
    reply = client.read_input_registers(address, count=2 * count, device_id=1)
    return np.array(reply.registers, dtype=">u2").view(">f4").astype(float)


def record(seconds: float) -> np.ndarray:
    """Rows of time, raw, position, velocity, true position, true velocity of AxisX."""
    demo = subprocess.Popen(
        [sys.executable, "-m", "softplc", "demo", "--json", "--headless"], stdout=subprocess.PIPE, text=True
    )
    try:
        facts = json.loads(_document(demo))
        own = _client(facts["endpoints"]["modbus"])
        plc = _client(facts["sources"]["plc_modbus"])
        rows = []
        start = time.monotonic()
        while (now := time.monotonic() - start) < seconds:
            position, velocity, raw = floats(own, 3000, 3)
            truth = floats(plc, TRUTH_REGISTER, 2)
            rows.append((now, raw, position, velocity, *truth))
            time.sleep(0.05)
        return np.array(rows)
    finally:
        demo.terminate()
        demo.wait(10)


TRUTH_REGISTER = 102  # true position and velocity of the emulated PLC's first axis, config/scenario.yaml


def _document(demo: subprocess.Popen[str]) -> str:
    assert demo.stdout is not None
    lines = []
    for line in demo.stdout:
        lines.append(line)
        if line.startswith("}"):
            break
    return "".join(lines)


def _client(endpoint: str) -> ModbusTcpClient:
    host, _, port = endpoint.rsplit("//", maxsplit=1)[-1].split(maxsplit=1)[0].partition(":")
    client = ModbusTcpClient(host, port=int(port))
    if not client.connect():
        raise SystemExit(f"no connection to {endpoint}")
    return client


def draw(rows: np.ndarray, output: Path) -> None:
    """Position above, velocity below; grey measured, orange filtered, black true."""
    t, raw, position, velocity, true_position, true_velocity = rows.T
    figure = plt.figure(figsize=(12, 6.5), layout="constrained")
    grid = figure.add_gridspec(2, 5)
    above, corner, below = (figure.add_subplot(grid[cells]) for cells in (np.s_[0, :3], np.s_[0, 3:], np.s_[1, :]))
    stop = t[np.argmax((true_velocity == 0.0) & (t > 5.0))]
    for axis in (above, corner):
        axis.plot(t, raw, color="#b0b0b0", linewidth=1, label="measured")
        axis.plot(t, true_position, color="black", linewidth=0.9, linestyle="--", label="true")
        axis.plot(t, position, color="#e8710a", linewidth=1.8, label="filtered (softplc)")
    above.set_ylabel("position, mm")
    above.legend(loc="upper left", frameon=False)
    corner.set_xlim(stop - 1.5, stop + 4.0)
    at_rest = true_position[np.argmax(t >= stop)]
    corner.set_ylim(at_rest - 14, at_rest + 5)
    corner.set_title("the stop, enlarged", fontsize=10)
    difference = np.diff(raw) / np.maximum(np.diff(t), 1e-3)
    below.plot(t[1:], difference, color="#d8d8d8", linewidth=0.8, label="difference of two samples")
    below.plot(t, true_velocity, color="black", linewidth=0.8, linestyle="--", label="true")
    below.plot(t, velocity, color="#e8710a", linewidth=1.8, label="filtered (softplc)")
    below.set_ylim(-30, 40)
    below.set_ylabel("velocity, mm/s")
    below.set_xlabel("time, s")
    below.legend(loc="upper right", frameon=False, ncols=3)
    for axis in (above, corner, below):
        axis.grid(alpha=0.25)
    output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(output, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=38.0)
    parser.add_argument("--output", type=Path, default=Path("docs/img/filtered-axis.png"))
    options = parser.parse_args()
    draw(record(options.seconds), options.output)


if __name__ == "__main__":
    main()
