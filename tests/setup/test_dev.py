"""The commands of dev.py, run as a person runs them."""

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from tests.setup.clones import ROOT, call, put_program


def test_help_names_every_command_and_makes_no_environment(clone: Path):
    done = call(clone, "--help")

    assert done.returncode == 0
    for command in ("demo", "test", "lint", "bench", "chaos", "soak", "fuzz", "softplc"):
        assert f"python3 dev.py {command}" in done.stdout
    assert not (clone / ".venv").exists()


def test_without_a_command_the_help_is_shown_and_the_exit_code_is_2(clone: Path):
    done = call(clone)

    assert (done.returncode, "python3 dev.py demo" in done.stdout) == (2, True)


def test_unknown_command_is_named_and_exits_2_without_making_anything(clone: Path):
    done = call(clone, "dmeo")

    assert done.returncode == 2
    assert done.stderr == "dev.py: there is no dmeo; see python3 dev.py --help\n"
    assert not (clone / ".venv").exists()


def test_bench_without_a_name_lists_the_benchmarks_and_with_a_wrong_one_exits_2(clone: Path):
    assert (call(clone, "bench").returncode, call(clone, "bench").stdout) == (0, "benchmarks: kernel\n")
    assert (call(clone, "bench", "nothing").returncode, call(clone, "bench", "nothing").stdout) == (
        2,
        "benchmarks: kernel\n",
    )


def test_arguments_and_exit_code_pass_through_and_the_command_runs_in_the_clone(ready: Path):
    done = call(ready, "demo", "--seconds", "5", "--headless", "two words")

    assert done.returncode == 7
    assert done.stdout == (
        f"['demo', '--seconds', '5', '--headless', 'two words'] {ready} {ready}/.venv/bin/softplc\n"
    )
    assert done.stderr == ""


def test_a_softplc_command_runs_where_it_is_called_so_that_paths_mean_what_they_say(ready: Path):
    done = call(ready, "softplc", "check", "my.yaml")

    assert done.stdout.startswith(f"['check', 'my.yaml'] {ready.parent} ")


def test_bench_passes_its_other_arguments_on(ready: Path):
    assert call(ready, "bench", "kernel", "--quick").stdout == "ran --quick\n"


def test_ctrl_c_reaches_the_command_alone_and_its_exit_code_0_stays_0(ready: Path):
    put_program(
        ready,
        "softplc",
        """
        import signal, sys
        signal.signal(signal.SIGINT, lambda *_: sys.exit(0))
        print("up", flush=True)
        signal.pause()
        """,
    )
    process = subprocess.Popen(
        [sys.executable, str(ready / "dev.py"), "demo"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the whole group

    assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 0


def test_dev_py_parses_as_python_3_6_so_that_an_old_python_says_what_is_needed():
    ast.parse((ROOT / "dev.py").read_text(), feature_version=(3, 6))


def old_pythons() -> list[str]:
    """Interpreters older than 3.11 on this machine that really run."""
    found = [shutil.which(f"python3.{minor}") for minor in range(6, 11)]
    runs = {path: subprocess.run([path, "-V"], capture_output=True, check=False) for path in found if path}
    return [path for path, done in runs.items() if done.returncode == 0]


def test_an_old_python_is_told_so_in_one_line():
    code = "import sys; sys.version_info = (3, 9, 2, 'final', 0); sys.argv = ['dev.py', 'demo']; import dev"
    commands = [[sys.executable, "-c", code], *([path, "dev.py", "demo"] for path in old_pythons())]
    for command in commands:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)

        assert done.returncode == 1
        assert re.fullmatch(
            r"dev\.py: softplc needs Python 3\.11 or newer, this is 3\.\d+; try python3\.11 dev\.py\n", done.stderr
        )


def test_dev_py_imports_the_standard_library_alone_and_is_short_enough_to_be_read():
    text = (ROOT / "dev.py").read_text()
    imported = set(re.findall(r"^ *(?:import|from) (\w+)", text, re.MULTILINE))

    assert imported <= sys.stdlib_module_names
    assert len(text.splitlines()) <= 150
