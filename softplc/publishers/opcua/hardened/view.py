"""Browse in pages and within bounds: the view services of one session."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from softplc.publishers.opcua.hardened.limits import Limits

_HAS_SUBTYPE = ua.NodeId(ua.ObjectIds.HasSubtype)
_ANY = ua.NodeId(ua.ObjectIds.Null)


class ReferenceTypes:
    """Reference types with all their subtypes, found once; they never change.

    asyncua walks the tree of types again for every reference that it looks at.
    """

    def __init__(self, space: Any) -> None:
        self._space = space
        self._families: dict[Any, frozenset[Any]] = {}

    def family(self, reference_type: Any) -> frozenset[Any] | None:
        """The type and its subtypes; None when there is no such reference type."""
        found = self._families.get(reference_type)
        node = self._space.get(reference_type)
        if found is None and node is not None:
            if node.attributes[ua.AttributeIds.NodeClass].value.Value.Value != ua.NodeClass.ReferenceType:
                return None
            children = [
                ref.NodeId for ref in node.references if ref.IsForward and ref.ReferenceTypeId == _HAS_SUBTYPE
            ]
            found = frozenset({reference_type}).union(*(self.family(child) or frozenset() for child in children))
            self._families[reference_type] = found
        return found


@dataclass(slots=True)
class _Rest:
    """References that a client has not fetched yet, and how many it wants at a time."""

    references: list[Any]
    page: int


class Browser:
    """Browse and BrowseNext of one session.

    asyncua: no BrowseNext, all references at once whatever was asked for, and no bound: one request for the same
    wide node a thousand times keeps everybody waiting for half a minute.
    """

    def __init__(self, space: Any, types: ReferenceTypes, limits: Limits) -> None:
        self._space, self._types, self._limits = space, types, limits
        self._rests: dict[bytes, _Rest] = {}

    def browse(self, descriptions: Sequence[Any], page: int) -> list[Any]:
        """One BrowseResult for each description, with at most `page` references (0: no limit of the client's)."""
        results, room = [], self._limits.references
        for description in descriptions:
            node = self._space.get(description.NodeId)
            if room <= 0:
                results.append(_failed(ua.StatusCodes.BadNoContinuationPoints))
                continue
            found = self._matches(node, description)
            if isinstance(found, list):
                room -= len(node.references)
                results.append(self._first(found, page))
            else:
                results.append(_failed(found))
        return results

    def browse_next(self, points: Sequence[bytes], *, release: bool) -> list[Any]:
        """The next page of each continuation point; with `release` they are only let go."""
        results = []
        for point in points:
            rest = self._rests.pop(point or b"", None)
            if rest is None:
                results.append(_failed(ua.StatusCodes.BadContinuationPointInvalid))
            elif release:
                results.append(ua.BrowseResult())
            else:
                results.append(self._first(rest.references, rest.page))
        return results

    def _matches(self, node: Any, description: Any) -> "list[Any] | int":
        """References that the description asks for, or the status that says why there are none."""
        if node is None:
            return int(ua.StatusCodes.BadNodeIdUnknown)
        directions = {
            ua.BrowseDirection.Forward: (True,),
            ua.BrowseDirection.Inverse: (False,),
            ua.BrowseDirection.Both: (True, False),
        }.get(description.BrowseDirection)
        if directions is None:
            return int(ua.StatusCodes.BadBrowseDirectionInvalid)
        wanted = None
        if description.ReferenceTypeId != _ANY:
            wanted = self._types.family(description.ReferenceTypeId)
            if wanted is None:
                return int(ua.StatusCodes.BadReferenceTypeIdInvalid)
            if not description.IncludeSubtypes:
                wanted = frozenset({description.ReferenceTypeId})
        classes = description.NodeClassMask
        return [
            reference
            for reference in node.references
            if reference.IsForward in directions
            and (wanted is None or reference.ReferenceTypeId in wanted)
            and (not classes or classes & reference.NodeClass)
        ]

    def _first(self, references: list[Any], page: int) -> Any:
        """A result with the first page; the rest is kept for BrowseNext."""
        if not page or len(references) <= page:
            return ua.BrowseResult(References=references)
        if len(self._rests) >= self._limits.continuation_points:
            return _failed(ua.StatusCodes.BadNoContinuationPoints)
        point = os.urandom(16)
        self._rests[point] = _Rest(references[page:], page)
        return ua.BrowseResult(ContinuationPoint=point, References=references[:page])


def _failed(code: int) -> Any:
    return ua.BrowseResult(ua.StatusCode(code))
