import asyncio
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from asyncua import Client
from pymodbus.client import AsyncModbusTcpClient

from softplc.emulator.run import Endpoints, claim, followed, serve
from softplc.errors import SoftplcError
from tests.emulator.scenarios import START_WITHIN, emulator, scenario, spawn
from tests.support.network import eventually, free_port


def accepts(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


async def test_sigterm_ends_the_process_with_exit_code_0_and_silently_while_clients_are_connected(
    capfd: pytest.CaptureFixture[str],
):
    with emulator(scenario(opcua={"port": 0}, modbus={"port": 0})) as plc:
        capfd.readouterr()
        modbus = AsyncModbusTcpClient("127.0.0.1", port=plc.port("modbus"), timeout=30, reconnect_delay=0)
        assert await modbus.connect()
        opcua = Client(plc.endpoints["opcua"], timeout=30)
        await opcua.connect()
        heard: list[float] = []

        class Handler:
            def datachange_notification(self, node: object, value: float, data: object) -> None:
                heard.append(value)

        subscription = await opcua.create_subscription(20, Handler())
        await subscription.subscribe_data_change(opcua.get_node("ns=2;s=AxisX.Position"))
        await eventually(lambda: len(heard) > 2, what="notifications")

        assert plc.process.pid is not None
        os.kill(plc.process.pid, signal.SIGTERM)
        await asyncio.to_thread(plc.process.join, 60)
        written = capfd.readouterr()
        modbus.close()
        await opcua.disconnect()

    assert plc.process.exitcode == 0
    assert (written.out, written.err) == ("", "")
    assert not accepts(plc.port("modbus"))
    assert not accepts(plc.port("opcua"))


async def test_sigterm_while_starting_ends_it_with_exit_code_0():
    process, connection = spawn(scenario(opcua={"port": 0}))
    try:
        assert process.pid is not None
        status = Path(f"/proc/{process.pid}/status")
        await eventually(lambda: handles_sigterm(status), START_WITHIN, "the process runs our code")
        os.kill(process.pid, signal.SIGTERM)
        process.join(60)
        assert process.exitcode == 0
    finally:
        process.kill()
        connection.close()


def handles_sigterm(status: Path) -> bool:
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return bool(int(lines["SigCgt"], 16) & 1 << (signal.SIGTERM - 1))


def test_sigint_is_left_to_the_parent():
    with emulator(scenario()) as plc:
        assert plc.process.pid is not None
        os.kill(plc.process.pid, signal.SIGINT)
        os.kill(plc.process.pid, signal.SIGTERM)
        plc.process.join(60)

    assert plc.process.exitcode == 0


@pytest.mark.parametrize("protocol", ["opcua", "modbus"])
def test_a_taken_port_is_named_and_ends_the_process(protocol: str, capfd: pytest.CaptureFixture[str]):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        process, connection = spawn(scenario(**{protocol: {"port": port}}))
        try:
            assert connection.poll(START_WITHIN)
            word, text = connection.recv()
            process.join(60)
        finally:
            process.kill()
            connection.close()

    assert word == "failed"
    assert text.startswith(f"{protocol}: cannot listen on 127.0.0.1:{port}: Address already in use")
    assert process.exitcode == 1
    assert capfd.readouterr().err == ""


async def test_it_ends_when_its_parent_dies():
    port = free_port()
    command = ("-m", "tests.emulator.orphan", str(port))
    root = Path(__file__).parent.parent.parent
    parent = await asyncio.create_subprocess_exec(sys.executable, *command, cwd=root, stdout=subprocess.PIPE)
    try:
        assert parent.stdout is not None
        assert await parent.stdout.readline() == b"ready\n"
        assert accepts(port)
    finally:
        parent.kill()
        await parent.wait()

    await eventually(lambda: not accepts(port), what="the port is free again")


async def test_cancelling_serve_closes_its_servers():
    started: list[Endpoints] = []
    port = free_port()
    task = asyncio.create_task(serve(scenario(modbus={"port": port}), started.append))
    await eventually(lambda: bool(started), what="ready")
    assert started == [{"modbus": f"tcp://127.0.0.1:{port}"}]
    async with AsyncModbusTcpClient("127.0.0.1", port=port, timeout=30) as client:
        assert (await client.read_holding_registers(4, device_id=1)).registers == [0x1234]

        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    claim("modbus", "127.0.0.1", port).close()


def test_a_claimed_port_is_held_and_0_is_any_free_one():
    held = claim("modbus", "127.0.0.1", 0)

    assert held.getsockname()[1] > 0
    held.close()


def test_a_host_that_is_not_ours_is_named():
    with pytest.raises(SoftplcError, match=r"opcua: cannot listen on 192\.0\.2\.1:4841: "):  # TEST-NET-1, RFC 5737
        claim("opcua", "192.0.2.1", 4841)


@pytest.mark.parametrize(
    ("measured", "kept"), [(1_000, 0), (400_000_000, 0), (-3_600_000_000_000, -3_600_000_000_000)]
)
def test_timestamps_stay_on_their_grid_until_somebody_sets_the_clock(measured: int, kept: int):
    assert followed(0, measured) == kept
