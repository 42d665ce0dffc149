"""The write half of the driver: what may be written, and its values as each variable's own type."""

from collections.abc import Sequence

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from softplc.drivers.opcua.binding import Binding, bind, group
from softplc.drivers.opcua.config import OpcUaTag
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.seam import proven
from softplc.drivers.opcua.fast.write import Target, Writes
from softplc.drivers.opcua.loops import find_loops
from softplc.drivers.opcua.session import Session, batches
from softplc.drivers.opcua.values import NUMBER_TYPES, encode, write_value
from softplc.interfaces import Positions
from softplc.sample import StatusCode, is_bad


class Writings:
    """The writings of one connection, by position. `slow` counts what asyncua has to decode."""

    def __init__(self, session: Session, tags: Sequence[OpcUaTag], slow: SlowState) -> None:
        self._session, self._slow = session, slow
        self._bindings = [group([tag])[0] for tag in tags]
        self._elements = [tag.index for tag in tags]
        self._loops: dict[int, str] = {}  # never written: they are read as well
        self._statuses: NDArray[np.uint32] = np.zeros(len(tags), np.uint32)  # not Good: it is not sent
        self._writes = Writes(session, [None] * len(tags), slow)

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with single writings, in words."""
        return (*(binding.problem for binding in self._bindings if binding.problem), *self._loops.values())

    @property
    def lost(self) -> list[Binding]:
        """Those that have a problem, which may be over: at first, all."""
        return [binding for binding in self._bindings if binding.problem]

    async def bind(self, readings: Sequence[Binding]) -> None:
        """Resolve and check those that are lost; none is written that is one of the readings. Raises LinkError."""
        lost = [position for position, binding in enumerate(self._bindings) if binding.problem]
        await bind(self._session, self.lost)
        self._loops.update(find_loops(readings, self._bindings))
        targets = list(self._writes.targets)
        for position in lost:
            targets[position] = self._target(position)
        if targets != self._writes.targets:
            self._writes = Writes(self._session, targets, self._slow)
        for position in {*lost, *self._loops}:
            self._statuses[position] = self._status(position)

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Write these; one that does not fit its variable's type is not sent and BadOutOfRange. Raises LinkError.

        Returns the raw StatusCode of each.
        """
        statuses = self._statuses[positions]
        ready = np.flatnonzero(statuses == StatusCode.GOOD)
        if ready.size:
            write = self._writes.write if proven() else self._write_by_the_library
            statuses[ready] = await write(positions[ready], values[ready])
        for one in ready[statuses[ready] != StatusCode.GOOD]:
            position = int(positions[one])
            self._bindings[position].note(int(statuses[one]))
            self._statuses[position] = self._status(position)
        return statuses

    async def _write_by_the_library(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        statuses = np.full(len(positions), StatusCode.BAD_OUT_OF_RANGE, np.uint32)
        requests: list[tuple[int, ua.WriteValue]] = []
        for place, (position, value) in enumerate(zip(positions.tolist(), values.tolist(), strict=True)):
            target = self._writes.targets[position]
            assert target is not None
            node, kind, element = target
            number = encode(value, kind)
            if number is not None:
                requests.append((place, write_value(node, number, element)))
        for some in batches(requests, self._session.limits.write):
            answers = await self._session.write([request for _, request in some])
            self._slow.messages += 1
            statuses[[place for place, _ in some]] = [int(answer.value) for answer in answers]
        return statuses

    def _status(self, position: int) -> int:
        """Why a writing is not written, Good where it is."""
        if position in self._loops:
            return StatusCode.BAD_CONFIGURATION_ERROR
        binding = self._bindings[position]
        if is_bad(binding.status):
            return binding.status
        return StatusCode.GOOD if self._writes.targets[position] else StatusCode.BAD_TYPE_MISMATCH

    def _target(self, position: int) -> Target | None:
        """What is to be written to, as the binding knows it now."""
        binding = self._bindings[position]
        if binding.node is None or binding.variant_type not in NUMBER_TYPES:
            return None
        return binding.node, binding.variant_type, self._elements[position]
