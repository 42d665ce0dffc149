"""The softplc command as a user starts it: a process of its own, its ready document, its end."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def environment(**more: str) -> dict[str, str]:
    """The environment of a started program: finds the package wherever the working directory is."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


def softplc(
    *arguments: str, cwd: Path | None = None, timeout: float = 60.0, **more: str
) -> "subprocess.CompletedProcess[str]":
    """Run a command to its end."""
    return subprocess.run(
        [sys.executable, "-m", "softplc", *arguments],
        cwd=cwd or ROOT,
        env=environment(**more),
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


class Program:
    """A command that keeps running. Both outputs are collected; `ready` waits for the JSON document on stdout."""

    def __init__(
        self, *arguments: str, cwd: Path | None = None, start_new_session: bool = False, **more: str
    ) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "softplc", *arguments],
            cwd=cwd or ROOT,
            env=environment(**more),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=start_new_session,
        )
        self.out: list[str] = []
        self.err: list[str] = []
        self._threads = [
            threading.Thread(target=_collect, args=(stream, lines), daemon=True)
            for stream, lines in ((self.process.stdout, self.out), (self.process.stderr, self.err))
        ]
        for thread in self._threads:
            thread.start()

    def ready(self, timeout: float = 60.0) -> Any:
        """The JSON document that the program prints when it is ready."""
        deadline = time.monotonic() + timeout
        while "}\n" not in self.out:
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise AssertionError(f"not ready; exit code {self.process.poll()}\n{self.text()}")
            time.sleep(0.02)
        return json.loads("".join(self.out[: self.out.index("}\n") + 1]))

    def text(self) -> str:
        """All output so far."""
        return "".join(self.out) + "".join(self.err)

    def children(self) -> dict[str, int]:
        """Process ids of the direct children by name; one that has no name yet is left out."""
        pid = self.process.pid
        names = {}
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            try:
                name = Path(f"/proc/{child}/comm").read_text().strip()
                command = Path(f"/proc/{child}/cmdline").read_text()
            except OSError:
                continue
            if "spawn_main" in command:
                names[name.removeprefix("softplc-")] = int(child)
        return names

    def interrupt(self) -> None:
        """Ctrl-C: what a terminal sends to every process of the program; needs a session of its own."""
        try:
            os.killpg(self.process.pid, signal.SIGINT)
        except ProcessLookupError:
            return

    def end(self, number: int = signal.SIGTERM, timeout: float = 20.0) -> int:
        """Send a signal and wait; returns the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        code = self.process.wait(timeout)
        for thread in self._threads:
            thread.join(5)
        return code

    def __enter__(self) -> "Program":
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.end()


def _collect(stream: Any, lines: list[str]) -> None:
    with stream:
        for line in stream:
            lines.append(line)


def run_node(script: Path, arguments: Sequence[str], cwd: Path, timeout: float = 60.0) -> Any:
    """Run a peer's script to its end; returns the JSON that it prints."""
    done = subprocess.run(
        ["node", str(script), *arguments], cwd=cwd, capture_output=True, text=True, timeout=timeout, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
