"""Malformed Modbus frames by the million: our server in process and over sockets, our client over TCP and as RTU.

Usage: python3 dev.py fuzz modbus [--frames N] [--seed N] [PART ...]
N frames (2 000 000) go through the server's protocol, a twentieth of that over sockets while a neighbour reads, and
as many replies of lying devices to the client, half of that as RTU, a few to the whole driver over a socket. Every
response is compared with what the specification says. Streams that go wrong are kept in tests/fuzz/corpus/modbus,
which the tests replay. Prints a table; exit code 1 when something is wrong.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import structlog

from tests.fuzz import modbus_client, modbus_driver, modbus_server
from tests.fuzz.modbus_server import Result, WrongError

FRAMES = 2_000_000
SHARE = 20  # over sockets and to the client over TCP: one in so many
SERIAL_SHARE = 40
DRIVER_SHARE = 1000  # to the whole driver over a socket, where what is missing is waited for
MOST_GROWTH = 5 * 2**20
MOST_LOG = 2**20


def _sockets(frames: int, seed: int) -> Result:
    with tempfile.TemporaryDirectory() as folder:
        return modbus_server.over_sockets(frames, seed, Path(folder))


PARTS: dict[str, tuple[int, Callable[[int, int], Result]]] = {
    "server": (1, modbus_server.in_process),
    "sockets": (SHARE, _sockets),
    "client": (SHARE, modbus_client.tcp),
    "driver": (DRIVER_SHARE, modbus_driver.over_sockets),
    "rtu": (SERIAL_SHARE, modbus_client.rtu),
}


def main(arguments: list[str]) -> int:
    """Fuzz the parts that are named, or all; the exit code."""
    parser = argparse.ArgumentParser(
        prog="dev.py fuzz modbus", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("parts", nargs="*", metavar="PART", choices=[[], *PARTS], help=", ".join(PARTS))
    options = parser.parse_args(arguments)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    held = True
    print("| part | frames | seconds | memory grew by KiB | log | neighbour's answers | slowest ms | result |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for name in options.parts or PARTS:
        share, part = PARTS[name]
        try:
            found = part(max(options.frames // share, 1), options.seed)
        except WrongError as error:
            print(f"| {name} | | | | | | | **wrong**: {error} |", flush=True)
            held = False
            continue
        little = found.growth <= MOST_GROWTH and found.log <= MOST_LOG
        held &= little
        neighbour = f"{found.neighbour} | {found.slowest * 1e3:.0f}" if found.neighbour else "– | –"
        result = "holds" if little else "**too much**"
        print(
            f"| {name} | {found.frames} | {found.seconds:.1f} | {found.growth // 1024} | {found.log} | {neighbour} |"
            f" {result} |",
            flush=True,
        )
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
