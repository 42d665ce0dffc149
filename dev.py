#!/usr/bin/env python3
"""Set-up and everyday commands, from a clone, with nothing but Python 3.11 or newer.

  python3 dev.py demo [...]     emulated PLC, observer, OPC-UA and Modbus servers, on loopback
  python3 dev.py test [...]     the whole test suite; what follows goes to pytest
  python3 dev.py lint           ruff, mypy and the import contracts
  python3 dev.py bench [NAME]   one benchmark of bench/, or their names
  python3 dev.py soak [...]     a million scans of every observer with faulty samples, every status checked
  python3 dev.py chaos [...]    every fault of a source that we know, and what came of it, as a table
  python3 dev.py fuzz opcua     malformed messages by the thousand against a server of ours; or: fuzz modbus
  python3 dev.py softplc [...]  any other softplc command, as in: dev.py softplc check my.yaml

The first use makes .venv beside this file: uv and all the rest from requirements.lock, pinned by hash;
pip does it where uv cannot. Later uses only look whether that is still in order. Nothing is written
outside this folder, nothing needs root. Delete .venv to start afresh.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

VERSION = sys.version_info[:2]
if VERSION < (3, 11):  # the syntax of this file is that of 3.6, so that an older Python gets as far as here
    sys.exit(f"dev.py: softplc needs Python 3.11 or newer, this is {VERSION[0]}.{VERSION[1]}; try python3.11 dev.py")

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
PYTHON = str(VENV / "bin" / "python")
LOCK = ROOT / "requirements.lock"
STAMP = VENV / "made-from"
LINTERS = ("ruff check", "ruff format --check", "mypy", "lint-imports")
COMMANDS = {"demo": "softplc demo", "test": "pytest", "lint": "", "bench": "python", "chaos": "python -m tests.chaos"}
COMMANDS.update(soak="python -m tests.soak", fuzz="python -m tests.fuzz", softplc="softplc")


def say(text: str) -> None:
    """A message to the person; standard output belongs to the command."""
    print("dev.py:", text, file=sys.stderr, flush=True)


def run(*command: str, **options: Any) -> bool:
    """Run a program to its end; whether it is there and succeeded."""
    return shutil.which(command[0]) is not None and subprocess.run(command, check=False, **options).returncode == 0


def holds(assertion: str) -> bool:
    """Whether .venv has a Python for which this is true."""
    return run(PYTHON, "-I", "-c", "import sys, importlib.util; assert " + assertion, stderr=subprocess.DEVNULL)


def needed_stamp() -> "list[str]":
    """Two lines: Python version and folder, then the digest of lock and pyproject."""
    content = LOCK.read_bytes() + (ROOT / "pyproject.toml").read_bytes()
    return [f"{VERSION} {ROOT}", hashlib.sha256(content).hexdigest()]


def prepare() -> None:
    """Make .venv, or bring it up to date, unless it is in order. Exits with a message when that cannot be done."""
    needed = needed_stamp()
    found = STAMP.read_text().splitlines() if STAMP.exists() else needed[:1]  # no stamp: made by hand
    if found == needed and holds("importlib.util.find_spec('softplc')"):
        return
    if found[:1] != needed[:1] or not holds(f"sys.version_info[:2] == {VERSION} and importlib.util.find_spec('pip')"):
        try:
            import ensurepip
            import venv

            ensurepip.version()  # Debian without python3-venv may keep an empty folder of that name
        except (ImportError, AttributeError):
            sys.exit("dev.py: this Python cannot make a virtual environment; try: sudo apt install python3-venv")
        if VENV.exists():
            say("the .venv that is there does not work here, so it is made anew")
            shutil.rmtree(str(VENV))
        VENV.mkdir()
        STAMP.write_text("unfinished")
        venv.create(str(VENV), with_pip=True, symlinks=True)
        found = ["unfinished"]
    STAMP.write_text("unfinished")
    say("installing requirements.lock into .venv; the first time may take a minute")
    installed = install()
    STAMP.write_text("\n".join(needed if installed else found))
    if not installed:
        sys.exit("dev.py: not everything could be installed, see above; the same command tries again")


def install() -> bool:
    """Put the locked packages and softplc itself into .venv, with uv or else with pip; whether that worked."""
    env = dict(os.environ, UV_PYTHON_DOWNLOADS="never", UV_CACHE_DIR=str(VENV / "cache"))
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--no-cache-dir", "--disable-pip-version-check"]
    uv = [PYTHON, "-m", "uv", "pip", "install", "--quiet", "--python", PYTHON]

    def locked(tool: "list[str]", lock: Path, *options: str) -> bool:
        return run(*tool, "--require-hashes", *options, "-r", str(lock), env=env, stdout=sys.stderr)

    only_uv = VENV / "uv.txt"
    only_uv.write_text("".join(re.findall(r"^uv==(?:.*\\\n)+.*\n", LOCK.read_text(), re.MULTILINE)))
    if not (locked(pip, only_uv, "--only-binary=:all:") and locked(uv, LOCK)):
        say("uv does not work here, so pip does it; that takes longer")
        uv = pip
        if not locked(pip, LOCK):
            return False
    return run(*uv, "--no-deps", "--no-build-isolation", "--editable", str(ROOT), env=env, stdout=sys.stderr)


def main(command: str = "", *arguments: str) -> None:
    """Run one command in .venv and end with its exit code."""
    if command in {"", "-h", "--help"}:
        print(__doc__)
        sys.exit(0 if command else 2)
    if command not in COMMANDS:
        say(f"there is no {command}; see python3 dev.py --help")
        sys.exit(2)
    if command == "bench":
        benches = sorted(path.stem for path in (ROOT / "bench").glob("*.py"))
        if not arguments or arguments[0] not in benches:
            print("benchmarks:", *benches)
            sys.exit(2 if arguments else 0)
        arguments = (f"bench/{arguments[0]}.py", *arguments[1:])
    prepare()
    peers = ROOT / "tests" / "peers"
    there = "SOFTPLC_PEERS" in os.environ or (peers / "node_modules").is_dir() or not peers.is_dir()
    if command in {"bench", "chaos"} and not there:
        say("installing the third-party peers into tests/peers, from npm")
        if not run("npm", "ci", "--silent", "--ignore-scripts", "--no-audit", "--no-fund", cwd=str(peers)):
            say("npm could not install them; what needs one will say so")
    os.environ["PATH"] = os.pathsep.join([str(VENV / "bin"), os.environ.get("PATH", os.defpath)])
    if command != "softplc":  # which may name files of the folder where it is called
        os.chdir(str(ROOT))
    if command == "lint":
        failed = [linter for linter in LINTERS if not run(*linter.split())]
        sys.exit(f"dev.py: failed: {', '.join(failed)}" if failed else 0)
    program, *first = COMMANDS[command].split()
    os.execvp(program, [program, *first, *arguments])  # exit code and Ctrl-C are the command's own from here on


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except KeyboardInterrupt:
        sys.exit(130)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"dev.py: {error}")
