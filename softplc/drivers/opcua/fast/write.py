"""Writes of numbers: each variable's part of the request is encoded once, and the values are laid into it.

A WriteValue is a node id, an attribute, an index range and a DataValue; without status and timestamps, which many
PLCs refuse, its last bytes are the number. So only these are laid into a request that was made for its variables.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary
from numpy.typing import NDArray

from softplc.drivers.opcua.fast.plain import HEAD, SlowState, check_count, has_plain_head, has_plain_tail
from softplc.drivers.opcua.fast.records import BOOLEAN, NUMBERS
from softplc.drivers.opcua.fast.seam import Request, decode_head, decode_message
from softplc.drivers.opcua.session import Session, link_errors
from softplc.drivers.opcua.values import INTEGER_RANGES, LARGEST_FLOAT32, write_value
from softplc.interfaces import Positions
from softplc.sample import StatusCode

Target = tuple[ua.NodeId, ua.VariantType, int | None]
"""Node, type of its elements, index into an array or None."""

_REMEMBERED: Final = 8
_RANGES: Final = {
    **{kind: (float(lowest), float(highest + 1)) for kind, (lowest, highest) in INTEGER_RANGES.items()},
    ua.VariantType.Boolean: (0.0, 2.0),
    ua.VariantType.Float: (-LARGEST_FLOAT32, np.nextafter(LARGEST_FLOAT32, np.inf)),
    ua.VariantType.Double: (-np.inf, np.inf),
}
"""The lowest value that each type takes, and the first beyond its highest; all of them are float64 exactly."""
_LOWEST, _BEYOND = np.zeros(max(NUMBERS) + 1), np.zeros(max(NUMBERS) + 1)
for _kind, (_lowest, _beyond) in _RANGES.items():
    _LOWEST[_kind.value], _BEYOND[_kind.value] = _lowest, _beyond

Kinds = NDArray[np.uint8]
"""Type ids of numbers, 0 where there is none."""


def encoded(target: Target) -> bytes:
    """The WriteValue of a target; its last bytes are the number, 0."""
    node, kind, index = target
    return bytes(struct_to_binary(write_value(node, ua.Variant(0, kind), index)))


class WritePlan:
    """One Write request of these WriteValues, all numbers or Booleans. `slow` counts what asyncua has to decode."""

    def __init__(self, session: Session, parts: Sequence[bytes], kinds: Kinds, slow: SlowState) -> None:
        self._count = len(parts)
        self._session = session
        self._slow = slow
        self._what = f"{session.url}: Write"
        request = ua.WriteRequest(Parameters=ua.WriteParameters(NodesToWrite=[]))
        self._request: Request = session.encode(request, ua.WriteResponse)
        self._request.body[-4:] = len(parts).to_bytes(4, "little") + b"".join(parts)  # instead of none
        lengths = np.array([len(part) for part in parts])
        ends = len(self._request.body) - lengths.sum() + lengths.cumsum()
        self._parts: list[tuple[NDArray[np.intp], np.dtype[Any], NDArray[np.intp]]] = []
        for kind in np.unique(kinds):
            which = np.flatnonzero(kinds == kind)
            dtype = np.dtype(NUMBERS[int(kind)] if kind != BOOLEAN else "u1")
            begins = ends[which] - dtype.itemsize
            self._parts.append((which, dtype, begins[:, None] + np.arange(dtype.itemsize)))
        self._raw = np.frombuffer(self._request.body, np.uint8)

    def lay(self, values: NDArray[np.float64]) -> Request:
        """The request with these values, one for each part, each of which fits its type."""
        for which, dtype, places in self._parts:
            numbers = values[which]
            if dtype.kind != "f":
                numbers = np.rint(numbers)
            self._raw[places] = numbers.astype(dtype)[:, None].view(np.uint8)
        return self._request

    async def write(self, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Write; the raw StatusCode of each. Raises LinkError."""
        with link_errors(self._what):
            return self.take(await self._session.exchange(self.lay(values)))

    def take(self, body: bytes) -> NDArray[np.uint32]:
        """The StatusCodes in an answer. Raises anything on an answer that makes no sense."""
        count, plain = self._count, has_plain_head(body)
        begin = check_count(body, HEAD if plain else decode_head(body), count)
        statuses = np.frombuffer(body, "<u4", count, begin)
        if not plain or not has_plain_tail(body, begin + 4 * count):
            self._slow.messages += 1
            decode_message(ua.WriteResponse, body)
        return statuses


class Writes:
    """Writes to changing sets of `targets`, None where there is nothing to write to. `slow` as in the plan.

    A target is encoded when it is first written, and the request for a set put together from what is encoded; those
    for the last few sets are kept.
    """

    def __init__(self, session: Session, targets: list[Target | None], slow: SlowState) -> None:
        self.targets = targets
        self._session = session
        self._slow = slow
        self._kinds: Kinds = np.array([0 if target is None else target[1].value for target in targets], np.uint8)
        self._encoded: dict[int, bytes] = {}
        self._plans: list[tuple[Positions, WritePlan]] = []

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Write these; one that does not fit its type is not sent and BadOutOfRange. Raises LinkError.

        Returns the raw StatusCode of each.
        """
        statuses = np.full(len(values), StatusCode.BAD_OUT_OF_RANGE, np.uint32)
        sent = np.flatnonzero(fits(values, self._kinds[positions]))
        for begin in range(0, len(sent), self._session.limits.write):
            some = sent[begin : begin + self._session.limits.write]
            statuses[some] = await self._plan(positions[some]).write(values[some])
        return statuses

    def _plan(self, positions: Positions) -> WritePlan:
        for kept, plan in self._plans:
            if np.array_equal(kept, positions):
                return plan
        parts = [self._encoded.get(position) or self._encode(position) for position in positions.tolist()]
        plan = WritePlan(self._session, parts, self._kinds[positions], self._slow)
        self._plans = [*self._plans[-_REMEMBERED + 1 :], (positions, plan)]
        return plan

    def _encode(self, position: int) -> bytes:
        target = self.targets[position]
        assert target is not None
        self._encoded[position] = encoded(target)
        return self._encoded[position]


def fits(values: NDArray[np.float64], kinds: Kinds) -> NDArray[np.bool_]:
    """Which of these values `values.encode` takes for their types: finite, and in the type's range once rounded."""
    rounded = np.rint(values)
    judged = np.where(kinds >= ua.VariantType.Float.value, values, rounded)
    taken: NDArray[np.bool_] = np.isfinite(values) & (judged >= _LOWEST[kinds]) & (judged < _BEYOND[kinds])
    taken &= (kinds != BOOLEAN) | (values == rounded)
    return taken
