"""Malformed messages by the thousand against a server of ours.

Usage: python3 dev.py fuzz opcua|modbus [...]; see each with --help.
"""

import importlib
import sys

TARGETS = ("opcua", "modbus")


def main() -> int:
    if len(sys.argv) < 2 or sys.argv[1] not in TARGETS:
        print(__doc__, file=sys.stderr)
        return 0 if sys.argv[1:2] in (["-h"], ["--help"]) else 2
    return int(importlib.import_module(f"tests.fuzz.{sys.argv[1]}").main(sys.argv[2:]))


if __name__ == "__main__":
    sys.exit(main())
