"""The commands that keep running: demo, run, emulate."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from softplc.app.logs import configure_logs
from softplc.app.supervisor import Endpoints
from softplc.cli.output import messages, print_json
from softplc.config.models import Config, Log
from softplc.errors import SoftplcError

if TYPE_CHECKING:
    from softplc.app.demo import Demo


_DEMO_TRIES = 5  # another program may take a port between the choice of it and its use


def demo(seconds: float | None, *, headless: bool, as_json: bool) -> int:
    """Run the demo; see `softplc demo --help`."""
    from softplc.app.demo import demo_setup  # noqa: PLC0415

    started = False

    def on_start() -> None:
        nonlocal started
        started = True

    for left in reversed(range(_DEMO_TRIES)):
        demo = demo_setup()
        try:
            return _run_demo(demo, seconds, on_start, headless=headless, as_json=as_json)
        except SoftplcError:
            if started or not left or not demo.outrun():
                raise
    return SoftplcError.exit_code


def _run_demo(
    demo: "Demo", seconds: float | None, on_start: Callable[[], None], *, headless: bool, as_json: bool
) -> int:
    from softplc.app.running import run_with_emulator  # noqa: PLC0415

    configure_logs(demo.config.log, "supervisor")
    console = Console(highlight=False, soft_wrap=True, no_color=headless, force_terminal=False if headless else None)

    def ready(endpoints: Endpoints) -> None:
        on_start()
        for note in demo.notes:
            messages.print(f"note: {note}", style="yellow")
        if as_json:
            print_json({**_facts(demo.config, endpoints), "notes": demo.notes})
        else:
            lines = _block("softplc demo", demo.config, endpoints, _demo_hints(endpoints))
            console.print("\n".join(lines), markup=False)
        sys.stdout.flush()

    return run_with_emulator(demo.config, demo.scenario, seconds, ready)


def run(path: Path, seconds: float | None, *, as_json: bool) -> int:
    """Run the daemon; see `softplc run --help`."""
    from softplc.app.running import run_daemon  # noqa: PLC0415
    from softplc.config.load import load  # noqa: PLC0415

    config = load(path)
    configure_logs(config.log, "supervisor")

    def ready(endpoints: Endpoints) -> None:
        if as_json:
            print_json(_facts(config, endpoints))
        else:
            sys.stdout.write("\n".join(_block(f"softplc {path}", config, endpoints, [])) + "\n")
        sys.stdout.flush()

    return run_daemon(config, seconds, ready)


def emulate(path: Path, seconds: float | None, *, as_json: bool) -> int:
    """Run the emulated PLC; see `softplc emulate --help`."""
    from softplc.app.running import run_emulator_alone  # noqa: PLC0415
    from softplc.cli.emulated import block, facts  # noqa: PLC0415
    from softplc.config.load import load_model  # noqa: PLC0415
    from softplc.emulator.scenario import Scenario  # noqa: PLC0415

    scenario = load_model(path, Scenario)
    configure_logs(Log(), "supervisor")

    def ready(endpoints: Endpoints) -> None:
        if as_json:
            print_json(facts(scenario, endpoints))
        else:
            sys.stdout.write("\n".join(block(f"emulated PLC {path}", scenario, endpoints)) + "\n")
        sys.stdout.flush()

    return run_emulator_alone(scenario, seconds, ready)


def _facts(config: Config, endpoints: Endpoints) -> dict[str, Any]:
    """What the ready block says, as data."""
    return {
        "tasks": {task.name: {"period_ms": task.period_ms} for task in config.tasks},
        "axes": {axis.name: {"source": axis.input.source, "tag": str(axis.input)} for axis in config.axes},
        "sources": {source.name: _where(source) for source in config.sources},
        "endpoints": _by_kind(endpoints),
    }


def _by_kind(endpoints: Endpoints) -> dict[str, Any]:
    """Endpoint by kind of server; a list where there are several of a kind."""
    kinds: dict[str, list[str]] = {}
    for kind, endpoint in endpoints:
        kinds.setdefault(kind, []).append(endpoint)
    return {kind: found[0] if len(found) == 1 else found for kind, found in kinds.items()}


_SHOWN = 8  # axes and sources that the ready block lists one by one


def _block(title: str, config: Config, endpoints: Endpoints, hints: list[str]) -> list[str]:
    """The one block that says what runs and where to look."""
    tasks = ", ".join(f"{task.name} {task.period_ms:g} ms" for task in config.tasks)
    lines = [f"{title}   scan {tasks}"]
    rows = [("source", source.name, _where(source)) for source in config.sources]
    rows += [
        ("axis", axis.name, f"{axis.input} of {axis.input.source}, observer {axis.observer.type}")
        for axis in config.axes
    ]
    for kind in ("source", "axis"):
        of_kind = [row for row in rows if row[0] == kind]
        lines += [f"  {kind:<8} {name:<12} {text}" for _, name, text in of_kind[:_SHOWN]]
        if len(of_kind) > _SHOWN:
            lines.append(f"  {'':<8} and {len(of_kind) - _SHOWN} more")
    lines += [f"  {'serves':<8} {kind:<12} {endpoint}" for kind, endpoint in endpoints]
    return [*lines, *hints, "Ctrl-C stops"]


def _demo_hints(endpoints: Endpoints) -> list[str]:
    served = dict(endpoints)
    port = served.get("modbus", "").rpartition(":")[2].partition("/")[0] or "5020"
    softplc = _command()
    return [
        "what to try next:",
        f"  {softplc} browse {served.get('opcua', 'opc.tcp://127.0.0.1:4840')} --filter AxisX",
        f"  any OPC-UA client: {served.get('opcua', '')}, node ns=2;s=AxisX.Position (read-only, anonymous)",
        f"  any Modbus client: port {port}, unit 1, float 1.0 at input register 2 proves the word order",
        f"  point it at your PLC: edit config/minimal.yaml, then {softplc} check --connect and {softplc} run",
    ]


def _command() -> str:
    """What a person types here to call softplc: its path from a clone, else its name."""
    own = Path(sys.executable).parent / "softplc"
    return str(own.relative_to(Path.cwd())) if own.exists() and own.is_relative_to(Path.cwd()) else "softplc"


def _where(source: Any) -> str:
    """Where a source is, in one word."""
    if source.type == "opcua":
        return str(source.url)
    if source.type == "replay":
        return str(source.file)
    transport = source.transport
    if transport.type == "rtu":
        return f"{transport.device} {transport.baudrate} baud unit {source.unit_id}"
    return f"modbus://{transport.host}:{transport.port} unit {source.unit_id}"
