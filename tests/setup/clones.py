"""Clones made for the tests of dev.py: with a stub for every program that would need a network."""

import os
import shutil
import subprocess
import sys
import textwrap
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2]
PATH = "/usr/local/bin:/usr/bin:/bin"
NO_NETWORK = {"PATH": PATH, "PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull, "UV_OFFLINE": "1"}


def call(clone: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the clone's dev.py to its end, without index, in a home folder that must stay empty."""
    home = clone.parent / "home"
    home.mkdir(exist_ok=True)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "UV_", "COV"))}
    return subprocess.run(
        [sys.executable, str(clone / "dev.py"), *arguments],
        env=kept | NO_NETWORK | {"HOME": str(home)} | environment,
        cwd=clone.parent,
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )


def make_clone(folder: Path) -> Path:
    """A clone without .venv."""
    folder.mkdir()
    for name in ("dev.py", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    (folder / "bench").mkdir()
    (folder / "bench" / "kernel.py").write_text("import sys; print('ran', *sys.argv[1:])")
    return folder


def make_ready(clone: Path) -> Path:
    """Put its .venv in order, with a softplc command that says what it got and ends with code 7."""
    venv.create(clone / ".venv", symlinks=True)
    place_packages(clone)
    put_program(
        clone,
        "softplc",
        """
        import os, shutil, sys
        print(sys.argv[1:], os.getcwd(), shutil.which("softplc"))
        sys.exit(7)
        """,
    )
    (clone / ".venv" / "made-from").write_text(stamp(clone))
    return clone


INSTALLER = """
import os, signal, sys
what = f"{__package__} {'--editable' if '--editable' in sys.argv else os.path.basename(sys.argv[-1])}"
with open(os.path.join(sys.prefix, "installers"), "a") as log:
    log.write(what + "\\n")
failing = os.environ.get("FAILING", "nothing")
if failing == "hang":
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    print("hanging", file=sys.stderr, flush=True)
    signal.pause()
sys.exit(failing in what)
"""


def place_packages(clone: Path) -> None:
    """In the clone's .venv: a softplc to import, and a pip and a uv that write down what they are asked."""
    site = next((clone / ".venv" / "lib").glob("python*")) / "site-packages"
    for name in ("softplc", "pip", "uv"):
        (site / name).mkdir()
        (site / name / "__init__.py").touch()
        (site / name / "__main__.py").write_text(INSTALLER)


def installers(clone: Path) -> list[str]:
    """What pip and uv were asked to install, in order."""
    log = clone / ".venv" / "installers"
    return log.read_text().splitlines() if log.exists() else []


def put_program(clone: Path, name: str, code: str) -> None:
    """A program of the clone's .venv; through sh, since a first line cannot hold a path with a space."""
    script = clone / ".venv" / "bin" / name
    script.with_suffix(".py").write_text(textwrap.dedent(code))
    script.write_text(f'#!/bin/sh\nexec "{clone}/.venv/bin/python" "{script}.py" "$@"\n')
    script.chmod(0o755)


def stamp(clone: Path) -> str:
    """The stamp that the clone's dev.py asks for."""
    code = "import dev; print(*dev.needed_stamp(), sep=chr(10))"
    done = subprocess.run([sys.executable, "-c", code], cwd=clone, capture_output=True, text=True, check=True)
    return done.stdout.rstrip("\n")
