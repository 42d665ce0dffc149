"""Makes config/recording.csv: one minute of the emulated PLC's first axis, as config/scenario.yaml describes it.

Usage: PYTHONPATH=. .venv/bin/python docs/scripts/recording.py

Ramp, hold, ramp, hold at 10 mm/s, 4 · 15 s in 1200 rows of 50 ms: time in s, measured position with U(−2, 2) mm, true
position, both in mm. Seeded: the file is the same every time.
"""

from pathlib import Path

from softplc.config.load import load_model
from softplc.emulator.plant import Plant
from softplc.emulator.scenario import Scenario

CONFIG = Path(__file__).parents[2] / "config"
FILE = CONFIG / "recording.csv"
ROWS = 1200


def recording() -> str:
    """The content of the file."""
    scenario = load_model(CONFIG / "scenario.yaml", Scenario)
    plant = Plant(scenario)
    lines = ["t,position,truth"]
    for number in range(ROWS):
        axis = plant.at(number).axes[0]
        lines.append(f"{number * scenario.period:.2f},{axis.position:.3f},{axis.true_position:.1f}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    FILE.write_text(recording(), encoding="utf-8", newline="\n")
