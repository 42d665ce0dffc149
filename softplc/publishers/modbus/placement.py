"""Where each block of registers begins: header, tasks, sources, axes; pure, so that a configuration can be checked.

| registers   | what                                                       |
|-------------|------------------------------------------------------------|
| 0…99        | header: check constants, map version, counts, heartbeat    |
| 100…999     | tasks, 100 registers each, at most 9                       |
| 1000…2999   | sources, 20 registers each, at most 100                    |
| 3000…65535  | axes, 64 registers each, at most 977                       |
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final

REGISTERS: Final = 65536  # a Modbus address has 16 bits


@dataclass(frozen=True, slots=True)
class Area:
    """Equal blocks side by side: the n-th begins at start + n·stride; all lie below stop."""

    start: int
    stride: int
    stop: int

    @property
    def most(self) -> int:
        """How many blocks the area holds."""
        return (self.stop - self.start) // self.stride

    def address(self, number: int) -> int:
        """First register of the n-th block."""
        return self.start + number * self.stride


HEADER: Final = Area(0, 100, 100)
TASKS: Final = Area(100, 100, 1000)
SOURCES: Final = Area(1000, 20, 3000)
AXES: Final = Area(3000, 64, REGISTERS)


class PlacementError(ValueError):
    """The blocks do not fit. `problems` has one (position in the placements or None, text) for each thing wrong."""

    def __init__(self, problems: Sequence[tuple[int | None, str]]) -> None:
        super().__init__("; ".join(text for _, text in problems))
        self.problems = tuple(problems)


def place(
    tasks: int, sources: int, axes: Sequence[str], placements: Sequence[tuple[str, int]] = ()
) -> dict[str, int]:
    """First register of every axis: as placed, the others in their order in the free places of the grid.

    `tasks` and `sources` are how many there are, `axes` are all axes in the order of the tag table, `placements`
    are (axis, address). Raises PlacementError that names everything wrong at once: an unknown axis, one placed
    twice, an odd address, one outside the axes' area, an overlap, no room left.
    """
    problems: list[tuple[int | None, str]] = []
    for what, count, area in (("tasks", tasks, TASKS), ("sources", sources, SOURCES)):
        if count > area.most:
            problems.append((None, f"{count} {what}: the Modbus register map has room for {area.most}"))
    placed: dict[str, int] = {}
    for number, (axis, address) in enumerate(placements):
        wrong = _wrong(axis, address, axes, placed)
        if wrong:
            problems.append((number, wrong))
        else:
            placed[axis] = address
    others = [axis for axis in axes if axis not in placed]
    free = _free(placed.values())
    if len(others) > len(free):
        problems.append((None, f"{len(axes)} axes: the Modbus register map has room for {len(placed) + len(free)}"))
    if problems:
        raise PlacementError(problems)
    return placed | dict(zip(others, free, strict=False))


def _wrong(axis: str, address: int, axes: Sequence[str], placed: Mapping[str, int]) -> str:
    """What is wrong with one placement, beside those already accepted; empty when nothing is."""
    last = AXES.stop - AXES.stride
    if axis not in axes:
        near = get_close_matches(axis, axes, 1)
        return f"there is no axis {axis}" + (f"; did you mean {near[0]}?" if near else "")
    if axis in placed:
        return f"{axis} is placed twice, at {placed[axis]} and at {address}"
    if not AXES.start <= address <= last:
        return (
            f"{axis} at {address}: an axis block begins at {AXES.start}…{last}; below are header, tasks and sources"
        )
    if address % 2:
        return f"{axis} at {address}: expected an even address, so that floats lie at even addresses"
    for other, start in placed.items():
        if abs(address - start) < AXES.stride:
            reach = AXES.stride - 1
            return f"{axis} at {address}…{address + reach} overlaps {other} at {start}…{start + reach}"
    return ""


def _free(placed: Iterable[int]) -> list[int]:
    """Places of the grid that no placed block touches, lowest first."""
    touched = {(start + reach - AXES.start) // AXES.stride for start in placed for reach in (0, AXES.stride - 1)}
    return [AXES.address(slot) for slot in range(AXES.most) if slot not in touched]
