import asyncio
import os
import signal
import time
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from softplc.publishers.modbus.offsets import AXIS
from tests.support.network import eventually
from tests.support.program import Program


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A running demo in an empty directory, and the document that it printed."""
    directory = tmp_path_factory.mktemp("demo")
    home = tmp_path_factory.mktemp("home")
    with Program("demo", "--json", "--headless", cwd=directory, HOME=str(home)) as program:
        yield program, program.ready(), directory, home


def modbus(endpoint: str) -> ModbusTcpClient:
    host, _, port = endpoint.rsplit("//", maxsplit=1)[-1].split(maxsplit=1)[0].rstrip("/").partition(":")
    client = ModbusTcpClient(host, port=int(port))
    assert client.connect()
    return client


def float_at(client: ModbusTcpClient, address: int) -> float:
    reply = client.read_input_registers(address, count=2, device_id=1)
    assert not reply.isError(), reply
    return float(client.convert_from_registers(reply.registers, client.DATATYPE.FLOAT32, word_order="big"))


def test_the_document_says_where_everything_is(demo):
    _, facts, _, _ = demo
    assert facts["endpoints"]["opcua"].startswith("opc.tcp://127.0.0.1:")
    assert set(facts["axes"]) == {"AxisX", "AxisY"}
    assert facts["tasks"]["main"]["period_ms"] == 50


async def test_both_axes_become_good_and_stay_near_the_truth(demo):
    _, facts, _, _ = demo
    own, plc = modbus(facts["endpoints"]["modbus"]), modbus(facts["sources"]["plc_modbus"])
    for axis, truth in ((3000, 102), (3064, 122)):
        await eventually(lambda axis=axis: quality_of(own, axis) == 2, 30, "quality Good")
        errors = []
        for _ in range(40):
            errors.append(abs(float_at(own, axis) - float_at(plc, truth)))
            await asyncio.sleep(0.05)
        # noise is ±2 mm, the filter's own standard deviation under 0.6 mm, the reading is up to 3 scans late
        assert sorted(errors)[len(errors) // 2] < 3.0
    own.close()
    plc.close()


def quality_of(client: ModbusTcpClient, axis: int) -> int:
    reply = client.read_input_registers(axis + AXIS.offsets["Quality"], count=1, device_id=1)
    return int(reply.registers[0])


def test_all_listeners_are_on_loopback(demo):
    program, _, _, _ = demo
    pids = [program.process.pid, *program.children().values()]
    inodes = set()
    for pid in pids:
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            try:
                inodes.add(str(entry.readlink()))
            except OSError:
                continue
    listening = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:
                listening.append(fields[1].partition(":")[0])
    assert len(listening) == 4
    assert set(listening) <= {"0100007F", "00000000000000000000000001000000"}


def test_a_second_demo_takes_the_next_free_ports_with_a_note(demo):
    _, facts, _, _ = demo
    with Program("demo", "--json", "--headless") as second:
        other = second.ready()
        assert set(other["endpoints"].values()).isdisjoint(facts["endpoints"].values())
        assert len(other["notes"]) >= 4
        assert "is taken" in second.text()
        assert second.end(signal.SIGINT) == 0


def test_nothing_is_written_outside_the_working_directory(demo):
    _, _, directory, home = demo
    assert list(home.rglob("*")) == []
    assert list(directory.rglob("*")) == []


def test_ctrl_c_ends_with_exit_0_within_two_seconds_and_no_traceback(demo):
    program, _, _, _ = demo
    children = program.children()
    assert {"scan", "gateway"} < set(children)
    assert len(children) == 3
    begun = time.monotonic()
    os.kill(program.process.pid, signal.SIGINT)
    code = program.process.wait(30)
    took = time.monotonic() - begun
    assert code == 0
    assert "Traceback" not in program.text()
    assert not any(Path(f"/proc/{pid}").exists() for pid in children.values())
    assert took < 10  # 2 s on a machine of its own; the bound here is for a loaded one


def test_seconds_ends_by_itself_and_the_block_says_what_to_try_next():
    with Program("demo", "--seconds", "1", "--headless") as program:
        assert program.process.wait(60) == 0
        text = program.text()
    assert "softplc demo   scan main 50 ms" in text
    assert "what to try next" in text
    assert "Traceback" not in text


@pytest.mark.parametrize("seconds", [0.0, 0.3, 0.9])
async def test_an_impatient_ctrl_c_while_it_starts_ends_with_exit_0_and_no_traceback(seconds):
    with Program("demo", "--headless", start_new_session=True) as program:
        # Before that the interpreter is at its own start, where it may swallow a signal.
        await eventually(lambda: "pydantic" in Path(f"/proc/{program.process.pid}/maps").read_text(), 60.0)
        await asyncio.sleep(seconds)  # anywhere within the start; the claim holds for every moment of it
        for _ in range(2):
            program.interrupt()
            await asyncio.sleep(0.1)
        assert await asyncio.to_thread(program.process.wait, 30) == 0
    assert "Traceback" not in program.text()
