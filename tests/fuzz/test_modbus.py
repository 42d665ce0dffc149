"""Malformed Modbus frames: no crash, no wrong answer, no memory, no log, and nobody else notices."""

import asyncio
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

import pytest

from tests.fuzz import modbus_server
from tests.fuzz.modbus_frames import Stream, streams
from tests.fuzz.modbus_server import CORPUS, IMAGE, check
from tests.publishers_modbus.oracle import expected
from tests.publishers_modbus.support import serving

ROOT = Path(__file__).parent.parent.parent
KEPT = sorted(CORPUS.glob("*.bin"))


def fuzzed(part: str) -> list[str]:
    """The row of the command for one part; in a process of its own without measuring coverage, which is slow."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("COV")}
    command = [sys.executable, "-m", "tests.fuzz", "modbus", part]
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return [cell.strip() for cell in done.stdout.splitlines()[-1].split("|")[1:-1]]


@pytest.mark.timeout(300)  # 6 s on a quiet core
def test_two_million_malformed_frames_have_the_answers_of_the_specification_and_leave_no_memory():
    row = fuzzed("server")

    assert int(row[1]) >= 2_000_000
    assert row[-1] == "holds"


@pytest.mark.timeout(300)  # 3 s on a quiet core
def test_a_hundred_thousand_malformed_frames_over_sockets_disturb_no_neighbour_and_fill_no_log():
    row = fuzzed("sockets")

    assert int(row[1]) >= 100_000
    assert int(row[5]) > 100  # answers, each of which was right
    assert float(row[6]) < 5000  # ms: a stall, not what a busy machine does
    assert row[-1] == "holds"


@pytest.mark.timeout(300)  # 4 s on a quiet core
def test_a_hundred_thousand_lying_replies_give_no_wrong_value_and_no_exception_but_a_lost_link():
    row = fuzzed("client")

    assert int(row[1]) >= 100_000
    assert row[-1] == "holds"


@pytest.mark.timeout(300)  # 5 s, most of it waiting
def test_what_the_driver_reads_from_a_lying_device_on_a_socket_is_in_the_bytes_that_it_sent():
    assert fuzzed("driver")[-1] == "holds"


@pytest.mark.timeout(300)  # 4 s on a quiet core
def test_lying_replies_on_a_serial_line_are_taken_only_with_unit_and_checksum():
    row = fuzzed("rtu")

    assert int(row[1]) >= 50_000
    assert row[-1] == "holds"


def test_there_is_a_corpus():
    assert len(KEPT) >= 20


@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
async def test_what_was_kept_is_answered_as_specified_wherever_it_is_cut_and_over_a_socket(path: Path):
    data = path.read_bytes()
    for cut in range(0, len(data) + 1, 1 + len(data) // 500):
        check(data, (cut,))
    async with serving() as served:
        await asyncio.wait_for(modbus_server._one(served.port, Stream(data, 1)), 30)


def test_most_frames_of_a_stream_are_looked_at_before_it_ends():
    made = looked_at = 0
    for stream in islice(streams(5), 500):
        replies, _, _ = expected(stream.data, IMAGE)
        made += stream.frames
        looked_at += len(modbus_server._shape(replies))
    assert looked_at > 0.9 * made


def test_no_function_code_and_no_exception_is_left_out():
    functions, codes = set(), set()
    for stream in islice(streams(6), 2000):
        for head in modbus_server._shape(expected(stream.data, IMAGE)[0]):
            functions.add(head[7] & 0x7F)
            if head[7] & 0x80:
                codes.add(head[8])
    assert functions == set(range(128))
    assert codes == {1, 2, 3, 11}


def test_a_server_that_answers_a_little_wrong_is_found(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(modbus_server, "expected", lambda stream, image: expected(stream, image, frozenset({0, 1})))
    monkeypatch.setattr(modbus_server, "keep", lambda data: "not kept")
    with pytest.raises(modbus_server.WrongError, match="not as specified"):
        modbus_server.in_process(1000, seed=7)
