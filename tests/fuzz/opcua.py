"""The OPC-UA server under mutants of recorded conversations.

Usage: python3 dev.py fuzz opcua [--mutants N] [--sockets N] [--seed N]

Most mutants are handed to the server's connections inside its process, some are sent through sockets. Meanwhile it
scans, and another client monitors a counter. Prints a row of docs/opcua-server.md; exit code 1 when something is not
as it must be. 50 000 mutants take half a minute.
"""

import argparse
import asyncio
import contextlib
import json
import random
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from asyncua import Client

from tests.fuzz.opcua_client import RecordedClient
from tests.fuzz.opcua_messages import CORPUS, Message, corpus
from tests.fuzz.opcua_mutate import mutate, mutate_frame
from tests.support.network import free_port

MUTANTS, SOCKETS = 50_000, 2_000
WARM = 2_000  # mutants after which memory is measured first: what is made once is made by then
MOST_MIB, MOST_LOG = 5.0, 1 << 20
HEAD = (
    "| mutants + over sockets | a second | memory | log | slowest | not told to another client | its longest wait |\n"
    "|---|---|---|---|---|---|---|"
)
_ROLLS = 65536
_PORTION = 2_500
_AT_ONCE = 8  # sockets at a time
_PER_SOCKET = 10


class Host:
    """tests/fuzz/opcua_host.py as a process."""

    def __init__(self, process: Any, log: Path, port: int) -> None:
        self._process, self._log, self.port = process, log, port

    async def ask(self, **request: Any) -> dict[str, Any]:
        """One request and its answer. Raises AssertionError when the server is gone."""
        self._process.stdin.write(json.dumps(request).encode() + b"\n")
        return await self.line()

    async def line(self) -> dict[str, Any]:
        async with asyncio.timeout(100):
            line = await self._process.stdout.readline()
        assert line, f"the server ended: {self._log.read_text()[-2000:]}"
        found: dict[str, Any] = json.loads(line)
        return found

    def logged(self) -> int:
        """Bytes of log so far."""
        return self._log.stat().st_size


@contextlib.asynccontextmanager
async def hosted(limits: dict[str, int] | None = None, files: int = 0) -> AsyncIterator[Host]:
    """A server in a process of its own, with other limits, and with so many files that it may open."""
    with tempfile.TemporaryDirectory() as folder:
        log, port = Path(folder) / "log", free_port()
        with log.open("wb") as errors:
            process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "tests.fuzz.opcua_host", str(port), json.dumps(limits or {}), str(files),
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=errors,
                cwd=Path(__file__).parents[2], limit=1 << 24,
            )  # fmt: skip
        host = Host(process, log, port)
        try:
            await host.line()
            yield host
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()


class Neighbour:
    """Another client, which monitors the scan counter: no value may be missing."""

    def __init__(self) -> None:
        self.beats: list[int] = []
        self.longest = 0.0
        self._last = 0.0

    def datachange_notification(self, _node: Any, value: int | None, _data: Any) -> None:
        if value is None and not self.beats:
            return  # from before the server's first publish
        now = time.monotonic()
        if self._last:
            self.longest = max(self.longest, now - self._last)
        self._last = now
        self.beats.append(-1 if value is None else value)  # one that is lost on the way counts as missing

    def missing(self) -> int:
        """Scans of which it was not told."""
        pairs = zip(self.beats, self.beats[1:], strict=False)
        return sum((after - before - 1) % _ROLLS for before, after in pairs)


@dataclass
class Outcome:
    """What came of a run."""

    mutants: int = 0
    sockets: int = 0
    seconds: float = 0.0
    grown: float = 0.0
    log: int = 0
    missing: int = 0
    beats: int = 0
    longest: float = 0.0
    slowest: float = 0.0
    surprises: list[Any] = field(default_factory=list)
    slow: list[Any] = field(default_factory=list)

    def faults(self) -> list[str]:
        """What is not as it must be."""
        found = []
        if self.grown > MOST_MIB:
            found.append(f"{self.grown:.1f} MiB more memory, {MOST_MIB} is the most")
        if self.log > MOST_LOG:
            found.append(f"{self.log} bytes of log")
        if self.missing or self.beats < 2:
            found.append(f"the other client was not told of {self.missing} scans, of {self.beats} it was")
        found += [f"unexpected in the server: {place}, {count} times" for place, count in self.surprises]
        found += [f"busy for {seconds} s with {data}" for seconds, data in self.slow]
        return found

    def row(self) -> str:
        """For docs/opcua-server.md."""
        return (
            f"| {self.mutants:,} + {self.sockets:,} | {self.mutants / self.seconds:,.0f} | {self.grown:+.1f} MiB "
            f"| {self.log / 1024:.0f} KiB | {self.slowest * 1e3:.0f} ms | {self.missing} of {self.beats:,} | "
            f"{self.longest * 1e3:.0f} ms |"
        ).replace(",", " ")


async def run(mutants: int, sockets: int, seed: int) -> Outcome:
    """So many mutants in process and through sockets. Raises AssertionError when the server ends or hangs."""
    outcome = Outcome(mutants, sockets)
    async with hosted() as host, patient(host) as client:
        neighbour = Neighbour()
        subscription = await client.create_subscription(50, neighbour)
        await subscription.subscribe_data_change(client.get_node("ns=2;s=Tasks.main.Heartbeat"), queuesize=100)
        before = (await host.ask(feed=seed, count=WARM))["rss"]
        begun = time.monotonic()
        for number, start in enumerate(range(0, mutants, _PORTION), start=1):
            answer = await host.ask(feed=(seed << 20) + number, count=min(_PORTION, mutants - start))
            outcome.slowest = max(outcome.slowest, answer["worst"])
            outcome.slow += answer["slow"]
        outcome.seconds = time.monotonic() - begun
        await through_sockets(host.port, sockets, seed)
        answer = await host.ask()
        outcome.grown = answer["rss"] - before
        outcome.surprises = answer.get("surprises", [])
        assert await client.get_namespace_array()
        async with patient(host) as newcomer:
            assert await newcomer.get_node("ns=2;s=AxisX.Position").read_value() is not None
        outcome.log = host.logged()
        outcome.missing, outcome.beats, outcome.longest = neighbour.missing(), len(neighbour.beats), neighbour.longest
    return outcome


def patient(host: Host) -> Client:
    """A client that does not give up on its own on a machine that is busy."""
    return Client(f"opc.tcp://127.0.0.1:{host.port}", timeout=60, watchdog_intervall=60)


async def through_sockets(port: int, count: int, seed: int) -> None:
    """Mutants over connections of their own, whatever the server answers."""
    messages = corpus()
    left = iter(range(0, count, _PER_SOCKET))

    async def one() -> None:
        for number in left:
            with contextlib.suppress(OSError, EOFError, asyncio.LimitOverrunError):
                await _talk(port, messages, random.Random(seed * 1_000_003 + number))

    await asyncio.gather(*(one() for _ in range(_AT_ONCE)))


async def _talk(port: int, messages: list[Message], chance: random.Random) -> None:
    client = await RecordedClient.connect(port, timeout=2)
    channel, requests = client.channel, [message for message in messages if message.kind == b"MSG"]

    def perhaps(data: bytes) -> bytes:
        return mutate_frame(data, chance) if chance.random() < 0.1 else data

    try:
        await client.open_channel(perhaps)
        await client.log_in()
        await client.subscribe()
        for _ in range(_PER_SOCKET):
            message = chance.choice(requests)
            client.writer.write(perhaps(channel.message(channel.fill(mutate(message, requests, chance)))))
        last = next(message for message in requests if message.service == "GetEndpointsRequest")
        client.writer.write(channel.message(channel.fill(last.body)))
        async with asyncio.timeout(2):
            await client.reader.readuntil(b"opc.tcp")  # the last answer, unless the connection ended before
    finally:
        client.drop()


def known_cases() -> list[list[str]]:
    """What was found once and is sent again ever since: one case per line of corpus/opcua/found/*.txt."""
    return [line.split()[1:] for path in sorted((CORPUS / "found").glob("*.txt"))
            for line in path.read_text().splitlines()]  # fmt: skip


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="dev.py fuzz opcua", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)  # fmt: skip
    parser.add_argument("--mutants", type=int, default=MUTANTS)
    parser.add_argument("--sockets", type=int, default=SOCKETS)
    parser.add_argument("--seed", type=int, default=4840)
    options = parser.parse_args(arguments)
    outcome = asyncio.run(run(options.mutants, options.sockets, options.seed))
    print(HEAD)
    print(outcome.row())
    for fault in outcome.faults():
        print(fault, file=sys.stderr)
    return 1 if outcome.faults() else 0
