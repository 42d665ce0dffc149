"""How dev.py makes .venv, sees that it is in order, and says what is in the way."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.setup.clones import call, installers, stamp

CANNOT_MAKE = "dev.py: this Python cannot make a virtual environment; try: sudo apt install python3-venv\n"


def test_the_stamp_changes_with_lock_pyproject_folder_and_nothing_else(clone: Path, tmp_path: Path):
    first = stamp(clone)
    assert stamp(clone) == first
    seen = {first}
    for name in ("requirements.lock", "pyproject.toml"):
        with (clone / name).open("a") as file:
            file.write("\n# changed")
        seen.add(stamp(clone))
    seen.add(stamp(clone.rename(tmp_path / "moved")))

    assert len(seen) == 4


def test_with_everything_in_place_nothing_is_installed_and_nothing_said(ready: Path):
    done = call(ready, "demo", FAILING="anything would")

    assert (done.returncode, done.stderr) == (7, "")
    assert installers(ready) == []


def test_a_changed_lock_is_installed_by_uv_into_the_environment_that_is_there(ready: Path):
    with (ready / "requirements.lock").open("a") as file:
        file.write("\n# changed")
    done = call(ready, "demo")

    assert done.returncode == 7
    assert done.stderr == "dev.py: installing requirements.lock into .venv; the first time may take a minute\n"
    assert installers(ready) == ["pip uv.txt", "uv requirements.lock", "uv --editable"]
    assert re.fullmatch(r"uv==\S+ \\\n( +--hash=sha256:\w{64}( \\)?\n)+", (ready / ".venv" / "uv.txt").read_text())
    assert (ready / ".venv" / "made-from").read_text() == stamp(ready)


@pytest.mark.parametrize("failing", ["pip uv.txt", "uv requirements.lock"])
def test_where_uv_is_not_to_be_had_or_does_not_work_pip_does_it(ready: Path, failing: str):
    (ready / ".venv" / "made-from").unlink()  # as after making .venv by hand
    done = call(ready, "demo", FAILING=failing)

    assert done.returncode == 7
    assert "dev.py: uv does not work here, so pip does it; that takes longer\n" in done.stderr
    assert installers(ready)[-2:] == ["pip requirements.lock", "pip --editable"]
    assert (ready / ".venv" / "made-from").read_text() == stamp(ready)


@pytest.mark.parametrize("failing", ["requirements.lock", "--editable"])
def test_what_cannot_be_installed_is_said_and_tried_again_next_time(ready: Path, failing: str):
    (ready / ".venv" / "made-from").unlink()
    done = call(ready, "demo", FAILING=failing)
    again = call(ready, "demo")

    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith(
        "dev.py: not everything could be installed, see above; the same command tries again\n"
    )
    assert again.returncode == 7
    assert "made anew" not in again.stderr


@pytest.mark.parametrize("harm", ["packages gone", "python gone", "half made", "moved", "other Python"])
def test_an_environment_that_is_half_made_or_broken_is_neither_used_nor_mended(
    ready: Path, hidden_ensurepip: str, harm: str
):
    environment = ready / ".venv"
    match harm:
        case "packages gone":
            shutil.rmtree(environment / "lib")
        case "python gone":
            (environment / "bin" / "python").unlink()
            (environment / "bin" / "python").symlink_to("gone")
        case "half made":
            (environment / "made-from").write_text("unfinished")
        case "moved":
            ready = ready.rename(ready.parent / "moved")
        case "other Python":
            text = (environment / "made-from").read_text()
            (environment / "made-from").write_text(text.replace("(3, ", "(3, 9"))
    done = call(ready, "demo", PYTHONPATH=hidden_ensurepip)  # which stops it where it would be made anew

    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == CANNOT_MAKE


def test_a_half_made_environment_is_made_anew_and_without_network_that_ends_in_a_message(ready: Path):
    (ready / ".venv" / "made-from").write_text("unfinished")
    done = call(ready, "demo")  # the real pip of a real environment, which has no index here

    assert (done.returncode, done.stdout) == (1, "")
    assert "dev.py: the .venv that is there does not work here, so it is made anew\n" in done.stderr
    assert done.stderr.endswith("the same command tries again\n")
    assert "Traceback" not in done.stderr
    assert (ready / ".venv" / "made-from").read_text() == "unfinished"
    assert not list((ready.parent / "home").iterdir())


def test_ctrl_c_while_installing_ends_without_traceback_and_the_environment_counts_as_half_made(ready: Path):
    (ready / ".venv" / "made-from").unlink()
    process = subprocess.Popen(
        [sys.executable, str(ready / "dev.py"), "demo"],
        env=os.environ | {"FAILING": "hang"},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stderr is not None
    assert any("hanging" in line for line in process.stderr)
    os.killpg(process.pid, signal.SIGINT)

    assert process.communicate(timeout=60) == (None, "")
    assert process.returncode == 130
    assert (ready / ".venv" / "made-from").read_text() == "unfinished"


def test_missing_ensurepip_says_what_to_install_and_leaves_nothing_behind(clone: Path, hidden_ensurepip: str):
    done = call(clone, "demo", PYTHONPATH=hidden_ensurepip)

    assert (done.returncode, done.stderr) == (1, CANNOT_MAKE)
    assert not (clone / ".venv").exists()


def test_an_empty_folder_in_the_place_of_ensurepip_counts_as_missing(clone: Path, hidden_ensurepip: str):
    Path(hidden_ensurepip, "ensurepip.py").write_text("")

    assert call(clone, "demo", PYTHONPATH=hidden_ensurepip).stderr == CANNOT_MAKE
