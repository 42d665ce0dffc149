import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.clock import VirtualClock
from softplc.exchange import DEAD_AFTER_AT_LEAST, Reader, Writer, size
from softplc.sample import StatusCode
from softplc.snapshot import Sheets, Snapshot
from softplc.tags import Image, Tag, TagTable
from softplc.timing import Scan

SECTIONS = (1, 3, 2)  # tags of each task


class Plant:
    """Three tasks of a writer, a reader, and plain copies of what the reader must show."""

    def __init__(self) -> None:
        self.clock, table = VirtualClock(), TagTable()
        for task, width in enumerate(SECTIONS):
            table.add_block(f"B{task}", "task", [Tag(f"Tasks.T{task}.{k}") for k in range(width)])
            table.close_section(f"T{task}")
        buffer = bytearray(size(table))
        self.sections = [(start, stop) for _, start, stop in table.sections]
        self.writer, self.reader = Writer(buffer, table), Reader(buffer, table, self.clock)
        self.sequences = np.frombuffer(buffer, np.int64, 12, 64).reshape(3, 4)[:, 0]
        self.image, self.expected = Image(len(table)), Image(len(table))
        self.scanned: list[float | None] = [None, None, None]
        self.number = 0

    def publish(self, section: int) -> None:
        self.number += 1
        start, stop = self.sections[section]
        for image in (self.image, self.expected):
            image.values[start:stop] = self.number
            image.statuses[start:stop] = StatusCode.GOOD
            image.source_timestamps[start:stop] = self.number
        self.scanned[section] = self.clock.monotonic()
        self.writer.publish(section, Scan(self.number, self.clock.monotonic(), 0, 0.01, 0.01, 0), self.image)

    def wait(self) -> None:
        """Tasks that do not scan meanwhile are dead."""
        self.clock.advance(DEAD_AFTER_AT_LEAST + 0.01)

    def read(self) -> Snapshot:
        for (start, stop), scanned in zip(self.sections, self.scanned, strict=True):
            if scanned is not None and self.clock.monotonic() - scanned > DEAD_AFTER_AT_LEAST:
                self.expected.fail(StatusCode.BAD_NO_COMMUNICATION, slice(start, stop))
        return self.reader.snapshot()


STEPS = st.sampled_from(["publish 0", "publish 1", "publish 2", "wait", "read", "read", "forget"])


@settings(deadline=None)
@given(st.lists(STEPS, max_size=60))
def test_a_snapshot_that_is_held_never_changes_and_the_newest_is_what_was_published(steps: list[str]) -> None:
    plant = Plant()
    held: list[tuple[list[np.ndarray], list[np.ndarray]]] = []  # parts of snapshots, and copies of them
    for step in (*steps, "read"):
        if step.startswith("publish"):
            plant.publish(int(step[-1]))
        elif step == "wait":
            plant.wait()
        elif step == "forget":
            del held[: len(held) // 2 + 1]
        else:
            snapshot = plant.read()
            np.testing.assert_array_equal(snapshot.values, plant.expected.values)
            np.testing.assert_array_equal(snapshot.statuses, plant.expected.statuses)
            np.testing.assert_array_equal(snapshot.source_timestamps, plant.expected.source_timestamps)
            arrays = [snapshot.values[1:4], snapshot.statuses[2:], snapshot.source_timestamps[:1]]
            held.append((arrays, [array.copy() for array in arrays]))
    for arrays, copies in held:
        for array, copy in zip(arrays, copies, strict=True):
            np.testing.assert_array_equal(array, copy)


def test_a_section_that_is_being_written_keeps_its_last_state_while_the_others_go_on() -> None:
    plant = Plant()
    for section in range(3):
        plant.publish(section)
    plant.reader.snapshot()
    plant.publish(1)
    plant.sequences[1] += 1  # as within publish

    snapshot = plant.reader.snapshot()
    plant.publish(2)
    later = plant.reader.snapshot()

    assert snapshot.values.tolist() == [1.0, 2.0, 2.0, 2.0, 3.0, 3.0]
    assert later.values.tolist() == [1.0, 2.0, 2.0, 2.0, 5.0, 5.0]
    assert [scan.number for scan in snapshot.scans if scan] == [1, 2, 3]


def test_what_was_copied_in_vain_is_not_shown() -> None:
    plant = Plant()
    sheets = Sheets(plant.reader.table)
    sheets.fill(0).values[:1] = 1.0
    sheets.filled(0)
    assert sheets.newest().values[0] == 1.0

    sheets.fill(0).values[:1] = 2.0  # half of it; no consistent copy was to be had
    sheets.fill(1).values[1:4] = 3.0
    sheets.filled(1)

    assert sheets.newest().values[:2].tolist() == [1.0, 3.0]


def test_memory_is_used_again_as_soon_as_nobody_holds_it() -> None:
    plant = Plant()
    places = set()
    for _ in range(50):
        plant.publish(1)
        places.add(plant.reader.snapshot().values.ctypes.data)

    assert len(places) == 2


def test_a_second_publisher_in_the_same_turn_gets_the_same_snapshot() -> None:
    plant = Plant()
    plant.publish(0)
    snapshot = plant.reader.snapshot()
    assert plant.reader.snapshot() is snapshot
    plant.wait()
    dead = plant.reader.snapshot()
    assert plant.reader.snapshot() is dead
    assert dead.alive == (False, False, False)
