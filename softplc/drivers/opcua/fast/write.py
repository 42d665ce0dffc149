"""Writes of always the same variables: each one's part of the request encoded once, the values laid into it.

A WriteValue is a node id, an attribute, an index range and a DataValue; without status and timestamps, which many
PLCs refuse, its last bytes are the number. So only these are laid into a request for variables that it was made for.
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
from softplc.drivers.opcua.session import Session, batches, link_errors
from softplc.drivers.opcua.values import INTEGER_RANGES, LARGEST_FLOAT32, write_value
from softplc.sample import StatusCode

Target = tuple[ua.NodeId, ua.VariantType, int | None]
"""Node, type of its elements, index into an array or None."""

_REMEMBERED: Final = 4
_EXACT: Final = frozenset({ua.VariantType.Float, ua.VariantType.Double})
_NOTHING: Final = (0.0, 0.0)
_RANGES: Final = {
    **{kind: (float(lowest), float(highest + 1)) for kind, (lowest, highest) in INTEGER_RANGES.items()},
    ua.VariantType.Boolean: (0.0, 2.0),
    ua.VariantType.Float: (-LARGEST_FLOAT32, np.nextafter(LARGEST_FLOAT32, np.inf)),
    ua.VariantType.Double: (-np.inf, np.inf),
}
"""The lowest value that each type takes, and the first beyond its highest; all of them are float64 exactly."""


class WritePlan:
    """One Write request for these targets; all are numbers or Booleans. `slow` counts what asyncua has to decode."""

    def __init__(self, session: Session, targets: Sequence[Target], slow: SlowState) -> None:
        self.targets = tuple(targets)
        self._session = session
        self._slow = slow
        self._what = f"{session.url}: Write"
        values = [write_value(node, ua.Variant(0, kind), index) for node, kind, index in targets]
        request = ua.WriteRequest(Parameters=ua.WriteParameters(NodesToWrite=values))
        self._request: Request = session.encode(request, ua.WriteResponse)
        lengths = np.array([len(struct_to_binary(value)) for value in values])
        ends = len(self._request.body) - lengths.sum() + lengths.cumsum()
        kinds = np.array([target[1].value for target in targets])
        self._parts: list[tuple[NDArray[np.intp], np.dtype[Any], NDArray[np.intp]]] = []
        for kind in np.unique(kinds):
            which = np.flatnonzero(kinds == kind)
            dtype = np.dtype(NUMBERS[int(kind)] if kind != BOOLEAN else "u1")
            begins = ends[which] - dtype.itemsize
            self._parts.append((which, dtype, begins[:, None] + np.arange(dtype.itemsize)))
        self._raw = np.frombuffer(self._request.body, np.uint8)

    def lay(self, values: NDArray[np.float64]) -> Request:
        """The request with these values, one for each target, each of which fits its type."""
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
        count, plain = len(self.targets), has_plain_head(body)
        begin = check_count(body, HEAD if plain else decode_head(body), count)
        statuses = np.frombuffer(body, "<u4", count, begin)
        if not plain or not has_plain_tail(body, begin + 4 * count):
            self._slow.messages += 1
            decode_message(ua.WriteResponse, body)
        return statuses


class Writes:
    """Writes to changing sets of variables: a plan for each of the last few sets. `slow` as in the plans."""

    def __init__(self, session: Session, slow: SlowState) -> None:
        self._session = session
        self._slow = slow
        self._plans: list[WritePlan] = []

    async def write(self, targets: Sequence[Target], values: Sequence[float]) -> list[int]:
        """Write these; one that does not fit its type is not sent and BadOutOfRange. Raises LinkError.

        Returns the raw StatusCode of each.
        """
        numbers = np.array(values, np.float64)
        fit = fits(numbers, [kind for _, kind, _ in targets])
        statuses = np.full(len(values), StatusCode.BAD_OUT_OF_RANGE, np.uint32)
        sent = np.flatnonzero(fit)
        for some in batches(sent.tolist(), self._session.limits.write):
            plan = self._plan(targets if len(some) == len(targets) else [targets[number] for number in some])
            statuses[some] = await plan.write(numbers[some])
        return [int(status) for status in statuses]

    def _plan(self, targets: Sequence[Target]) -> WritePlan:
        wanted = tuple(targets)
        for plan in self._plans:
            if plan.targets == wanted:
                return plan
        self._plans = [*self._plans[-_REMEMBERED + 1 :], WritePlan(self._session, wanted, self._slow)]
        return self._plans[-1]


def fits(values: NDArray[np.float64], kinds: Sequence[ua.VariantType]) -> NDArray[np.bool_]:
    """Which of these values `values.encode` takes for their types: finite, and in the type's range once rounded."""
    lowest, beyond = np.array([_RANGES.get(kind, _NOTHING) for kind in kinds], np.float64).reshape(-1, 2).T
    exact = np.array([kind in _EXACT for kind in kinds], np.bool_)
    rounded = np.rint(values)
    judged = np.where(exact, values, rounded)
    boolean = np.array([kind == ua.VariantType.Boolean for kind in kinds], np.bool_)
    taken: NDArray[np.bool_] = np.isfinite(values) & (judged >= lowest) & (judged < beyond)
    taken &= ~boolean | (values == rounded)
    return taken
