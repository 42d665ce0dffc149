"""All commands of the softplc command line, and how their errors become exit codes."""

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from softplc import __version__
from softplc.cli.output import messages
from softplc.errors import SoftplcError, UsageError

EXIT_CODES = "Exit codes: 0 ok, 1 failed, 2 usage, 69 source unreachable, 78 configuration."

cli = typer.Typer(
    name="softplc",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help=f"Filtered position and velocity beside a PLC, over OPC-UA and Modbus. {EXIT_CODES}",
)
export = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Print what other tools import.")
cli.add_typer(export, name="export")
study = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode=None,
    help="Run the experiment of a paper anew and write it down: one HTML report and its figures as PNG.",
)
cli.add_typer(study, name="study")

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG.yaml", help="Configuration file.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
_INTERRUPTED = 130

Seconds = Annotated[float | None, typer.Option("--seconds", min=0.1, help="End by itself after so many seconds.")]


def run_command_line() -> int:
    """Run the command of sys.argv; returns its exit code."""
    try:
        result = cli(standalone_mode=False)
        sys.stdout.flush()
    except typer.Exit as stop:
        return _or_interrupt(stop.exit_code)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except Exception as error:
        return _exit_code(error)
    return _or_interrupt(result) if isinstance(result, int) else 0


def _or_interrupt(code: int) -> int:
    """130 is how the command line tells Ctrl-C, which not every command takes for a failure."""
    if code == _INTERRUPTED:
        raise KeyboardInterrupt
    return code


def _exit_code(error: Exception) -> int:
    """Tell an error that is expected, and return its exit code; any other is raised again."""
    cause: BaseException = error
    while isinstance(cause, BaseExceptionGroup):  # as a task group raises it
        cause = cause.exceptions[0]
    if isinstance(cause, SoftplcError):
        messages.print(str(cause), style="red", markup=False)
        return cause.exit_code
    if isinstance(cause, BrokenPipeError):  # whoever read our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    show = getattr(cause, "show", None)  # the command line's own errors know how to show themselves
    if show is None:
        raise error
    show()
    return UsageError.exit_code


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"softplc {__version__}\n")
        raise typer.Exit


@cli.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Take the options that belong to no command."""


@cli.command()
def demo(
    seconds: Seconds = None,
    headless: Annotated[bool, typer.Option("--headless", help="No colours and no live values: for scripts.")] = False,
    as_json: AsJson = False,
) -> int:
    """Run everything on an emulated PLC that plays ramp–hold–ramp–hold with noise over OPC-UA and Modbus.

    Example: softplc demo --seconds 20 --headless
    """
    from softplc.cli.running import demo as run_demo  # noqa: PLC0415

    return run_demo(seconds, headless=headless, as_json=as_json)


@cli.command()
def run(config: ConfigPath, seconds: Seconds = None, as_json: AsJson = False) -> int:
    """Run the daemon with real sources until SIGINT or SIGTERM.

    Example: softplc run config/minimal.yaml
    """
    from softplc.cli.running import run as run_daemon  # noqa: PLC0415

    return run_daemon(config, seconds, as_json=as_json)


@cli.command()
def emulate(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="What the emulated PLC plays.")],
    seconds: Seconds = None,
    as_json: AsJson = False,
) -> int:
    """Run the emulated PLC alone: OPC-UA and Modbus servers on loopback, with truth tags.

    Example: softplc emulate config/scenario.yaml
    """
    from softplc.cli.running import emulate as run_emulator  # noqa: PLC0415

    return run_emulator(scenario, seconds, as_json=as_json)


@cli.command()
def check(
    config: ConfigPath,
    connect: Annotated[bool, typer.Option("--connect", help="Read every tag from its source for a second.")] = False,
    as_json: AsJson = False,
) -> int:
    """Validate a configuration without running it; with --connect read every tag for a second.

    Example: softplc check config/plant.yaml --connect
    """
    from softplc.cli.checking import check as run_check  # noqa: PLC0415

    return run_check(config, connect=connect, as_json=as_json)


@cli.command()
def browse(
    url: Annotated[str, typer.Argument(help="OPC-UA endpoint, as in opc.tcp://192.168.0.10:4840.")],
    contains: Annotated[str, typer.Option("--filter", help="Only paths or node ids that contain this text.")] = "",
    yaml: Annotated[bool, typer.Option("--yaml", help="Print only the block to paste into a configuration.")] = False,
    user: Annotated[
        str | None, typer.Option(help="Log in as this user; the password comes from SOFTPLC_PASSWORD.")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """List the variables of an OPC-UA server, and a block to paste into a configuration.

    Example: softplc browse opc.tcp://127.0.0.1:4841 --filter Position
    """
    from softplc.cli.checking import browse as run_browse  # noqa: PLC0415

    return run_browse(url, contains, yaml=yaml, user=user, as_json=as_json)


@cli.command()
def replay(
    config: ConfigPath,
    output: Annotated[Path | None, typer.Option("--output", help="CSV file to write; stdout when left out.")] = None,
) -> int:
    """Run a configuration of recordings on a virtual clock, as fast as possible, and print every scan as CSV.

    Example: softplc replay replay.yaml --output filtered.csv
    """
    from softplc.cli.checking import replay as run_replay  # noqa: PLC0415

    return run_replay(config, output)


@cli.command()
def schema() -> int:
    """Print the JSON Schema of the configuration, for editors."""
    from softplc.cli.output import print_json  # noqa: PLC0415
    from softplc.config.schema import json_schema  # noqa: PLC0415

    print_json(json_schema())
    return 0


@cli.command()
def health(
    config: Annotated[Path | None, typer.Argument(metavar="CONFIG.yaml", help="Whose servers to ask.")] = None,
    timeout: Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the heartbeat to move.")] = 3.0,
) -> int:
    """Exit 0 when a running softplc scans, 1 when it does not: asks its Modbus or OPC-UA server for the heartbeat.

    Without CONFIG the file that SOFTPLC_CONFIG names, or else the default ports are asked.
    """
    from softplc.cli.checking import health as run_health  # noqa: PLC0415

    return run_health(config, timeout)


@export.command("modbus-map")
def export_modbus_map(
    config: ConfigPath,
    style: Annotated[str, typer.Option("--format", help="csv, md or json.")] = "csv",
    port: Annotated[int | None, typer.Option(help="Which server, where the configuration has several.")] = None,
) -> int:
    """Print the register map of the Modbus server, from the table that the server uses.

    Example: softplc export modbus-map config/demo.yaml --format md
    """
    from softplc.cli.checking import modbus_map  # noqa: PLC0415

    if style not in ("csv", "md", "json"):
        raise UsageError(f"--format {style}: expected csv, md or json")
    return modbus_map(config, style, port)


Folder = Annotated[Path | None, typer.Option("--output", help="Folder to write into; study-NAME when left out.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the noise.")]


@study.command("aoi")
def study_aoi(output: Folder = None, seed: Seed = 0, as_json: AsJson = False) -> int:
    """Ramp–hold–ramp–hold of the AOI paper: its Figure 2, gains, bleed, scan rate, precision, other methods.

    Exits 1 when a claim does not hold, or when matplotlib is missing (pip install "softplc[study]").
    Example: softplc study aoi --output study-aoi
    """
    from softplc.cli.studying import aoi  # noqa: PLC0415

    return aoi(output or Path("study-aoi"), seed, as_json=as_json)


@study.command("ducekf")
def study_ducekf(output: Folder = None, seed: Seed = 0, as_json: AsJson = False) -> int:
    """The DUCEKF paper's oscillator with impacts: its Figures 1 to 3 and 5 to 7, Tables A1 and A2, statistics A.3.

    Exits 1 when a claim does not hold, or when matplotlib is missing (pip install "softplc[study]").
    Example: softplc study ducekf --output study-ducekf
    """
    from softplc.cli.studying import ducekf  # noqa: PLC0415

    return ducekf(output or Path("study-ducekf"), seed, as_json=as_json)


__all__: list[Any] = ["cli", "run_command_line"]
