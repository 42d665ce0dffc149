"""The commands that look and end: check, browse, replay, health, export."""

import asyncio
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from softplc.cli.output import messages, print_json, print_table
from softplc.errors import ConfigError, LinkError, SoftplcError, UsageError

if TYPE_CHECKING:
    from softplc.app.budget import Answers
    from softplc.config.models import Config

_SHOWN: Final = 50  # rows of a table that people read


def check(path: Path, *, connect: bool, as_json: bool) -> int:
    """Validate, and with `connect` read every tag for a second; see `softplc check --help`."""
    from softplc.app.checking import certificate_remarks, missing_secrets, read_once  # noqa: PLC0415
    from softplc.config.load import load  # noqa: PLC0415
    from softplc.config.remarks import remarks  # noqa: PLC0415

    try:
        config = load(path)
    except ConfigError as wrong:
        if as_json:
            print_json({"errors": wrong.lines})
        raise
    for text in (*missing_secrets(config), *certificate_remarks(config), *remarks(config)):
        messages.print(f"{path}: {text}", style="yellow", markup=False)
    if not connect:
        _print_axes(path, config, as_json=as_json)
        return 0
    rows, texts, answers = read_once(config)
    if as_json:
        print_json(rows)
    else:
        columns = ("tag", "source", "address", "value", "unit", "status", "quality", "new_per_s")
        print_table(rows, (*columns, "source_timestamp", "age_s"))
    for text in texts:
        messages.print(text, style="yellow", markup=False)
    unreachable = {str(row["source"]): str(row["error"]) for row in rows if row["error"]}
    for source, error in unreachable.items():
        messages.print(f"{source}: {error}", style="red", markup=False)
    if unreachable:
        return LinkError.exit_code
    _print_budget(path, config, answers)
    bad = [str(row["tag"]) for row in rows if row["quality"] == "Bad"]
    if bad:
        messages.print(f"Bad: {', '.join(bad)}", style="red", markup=False)
        return SoftplcError.exit_code
    return 0


def _print_axes(path: Path, config: "Config", *, as_json: bool) -> None:
    """The axes, what they will cost, and that all is well."""
    from softplc.app.checking import describe  # noqa: PLC0415

    rows = describe(config)
    if as_json:
        print_json(rows)
    else:
        print_table(rows[:_SHOWN], ("axis", "task", "period_ms", "source", "tag", "unit", "observer"))
        if len(rows) > _SHOWN:
            messages.print(f"… and {len(rows) - _SHOWN} more; --json prints all of them")
    _print_budget(path, config)
    messages.print(f"{path}: {_counted(config)}: valid", style="green")


def _print_budget(path: Path, config: "Config", answers: "Answers | None" = None) -> None:
    """How much of its period each task is predicted to take, with measured answers; a warning where it is much."""
    from softplc.app.budget import budgets, explanation, warnings  # noqa: PLC0415
    from softplc.app.layout import build_layout  # noqa: PLC0415

    found = budgets(build_layout(config), answers=answers)
    for budget in found:
        messages.print(f"{path}: {budget}", markup=False)
    messages.print(f"{path}: {explanation(measured=answers is not None)}", style="dim", markup=False)
    for text in warnings(found):
        messages.print(f"{path}: {text}", style="yellow", markup=False)


def _counted(config: "Config") -> str:
    """What a configuration has of everything, templates expanded."""
    counts = (("axis", "axes", config.axes), ("source", "sources", config.sources), ("task", "tasks", config.tasks))
    return ", ".join(f"{len(many)} {one if len(many) == 1 else more}" for one, more, many in counts)


def browse(url: str, contains: str, *, yaml: bool, user: str | None, as_json: bool) -> int:
    """List the variables of a server; see `softplc browse --help`."""
    from softplc.drivers.opcua.browse import browse as browse_server  # noqa: PLC0415
    from softplc.drivers.opcua.browse import yaml_block  # noqa: PLC0415
    from softplc.drivers.opcua.config import OpcUaUser  # noqa: PLC0415
    from softplc.model import Secret  # noqa: PLC0415
    from softplc.sample import status_name  # noqa: PLC0415

    if not url.startswith("opc.tcp://"):
        meant = url.rpartition("//")[2] or "127.0.0.1:4840"
        raise UsageError(f"{url}: expected an OPC-UA endpoint, as in opc.tcp://{meant}")
    login = OpcUaUser(name=user, password=Secret(env="SOFTPLC_PASSWORD")) if user else None
    listing = asyncio.run(browse_server(url, only=contains or None, user=login))
    rows = [
        {
            "path": variable.path,
            "node_id": variable.node,
            "node_id_by_uri": variable.node_by_uri,
            "data_type": variable.data_type
            if variable.length is None
            else f"{variable.data_type}[{variable.length}]",
            "value": variable.value,
            "status": status_name(variable.status),
            "writable": variable.writable,
        }
        for variable in listing.variables
    ]
    if as_json:
        print_json(rows)
    elif not rows:
        messages.print(
            f"no variable whose path or node id contains {contains!r}" if contains else "the server has no variables"
        )
    else:
        if not yaml:
            print_table(rows, ("path", "node_id", "data_type", "value"))
            sys.stdout.write("\n")
        sys.stdout.write(yaml_block(url, listing.variables))
    if not listing.complete:
        messages.print("the server has more; narrow it down with --filter", style="yellow")
    return 0


def replay(path: Path, output: Path | None) -> int:
    """Replay recordings; see `softplc replay --help`."""
    from softplc.app.logs import configure_logs  # noqa: PLC0415
    from softplc.app.replay import overlooked  # noqa: PLC0415
    from softplc.app.replay import replay as run_replay  # noqa: PLC0415
    from softplc.config.load import load  # noqa: PLC0415

    config = load(path)
    configure_logs(config.log, "replay")
    if output is None:
        scans = run_replay(config, sys.stdout)
    else:
        try:
            file = output.open("w", encoding="utf-8", newline="")
        except OSError as error:
            raise SoftplcError(f"{output}: cannot write: {error.strerror}") from error
        with file:
            scans = run_replay(config, file)
    messages.print(f"{scans} scans replayed")
    for sentence in overlooked(config):
        messages.print(sentence)
    return 0


def health(path: Path | None, timeout: float) -> int:
    """Ask a running softplc for its heartbeat; see `softplc health --help`."""
    from softplc.app.checking import configured_path  # noqa: PLC0415
    from softplc.app.health import check_health  # noqa: PLC0415
    from softplc.config.load import load  # noqa: PLC0415

    path = configured_path(path)
    problem = check_health(load(path) if path is not None else None, timeout)
    messages.print(problem or "scanning", style="red" if problem else "green", markup=False)
    return 1 if problem else 0


def modbus_map(path: Path, style: str, port: int | None) -> int:
    """Print the register map; see `softplc export modbus-map --help`."""
    from softplc.app.layout import build_layout  # noqa: PLC0415
    from softplc.config.load import load  # noqa: PLC0415
    from softplc.publishers.modbus.config import ModbusPublisher  # noqa: PLC0415
    from softplc.publishers.modbus.map import build_map, render  # noqa: PLC0415

    config = load(path)
    every = [publisher for publisher in config.publishers if isinstance(publisher, ModbusPublisher)]
    servers = [server for server in every if port in (None, server.port)]
    if not servers:
        found = ", ".join(str(server.port) for server in every) or "none"
        raise SoftplcError(f"{path}: no such publisher of type modbus; ports of those that there are: {found}")
    if len(servers) > 1:
        ports = ", ".join(str(server.port) for server in servers)
        messages.print(f"several Modbus servers ({ports}): this is the map of {servers[0].port}; choose with --port")
    sys.stdout.write(render(build_map(build_layout(config).table, servers[0]), style))
    return 0
