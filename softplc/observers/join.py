"""The state of observers moved into one of all their axes, exactly: each axis goes on as if nothing had happened.

What an observer remembers from scan to scan is in arrays whose last dimension are its axes, or those of its axes that
a piece of it is for (`Signal.chosen`); or it is a number for all of them. What of it differs from an observer just
built of the same axes is state; everything else is their configuration, and is there already.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from softplc.observers.observer import AxisObserver

_NUMBERS: Final = (bool, int, float)
_Told = dict[tuple[int, str], tuple[Any, list[Any]]]
"""Of each number of the new observer: what it belongs to, and what the parts have that is not as built."""


class UnlikeError(Exception):
    """The state of an observer does not fit into the other; the text tells where."""


class Part(NamedTuple):
    """An observer whose state moves, or a piece of it; the same of one just built; where its axes are in the new."""

    old: Any
    built: Any
    rows: NDArray[np.intp]


def join(new: AxisObserver, parts: Sequence[Part]) -> None:
    """Move the state of observers, all stepped in this scan, into a new one of all their axes.

    Raises UnlikeError; the new observer is of no use then, the others are as they were.
    """
    told: _Told = {}
    for part in parts:
        _move(new, part, sum(len(part.rows) for part in parts), told, set())
    for (_, name), (piece, changed) in told.items():
        if len(changed) == len(parts) and len(set(changed)) == 1:
            setattr(piece, name, changed[0])
        elif changed and not isinstance(changed[0], bool):  # a flag is what all have in common: false as built
            raise UnlikeError(f"{type(piece).__name__}.{name} is {changed}")


def _move(new: Any, part: Part, axes: int, told: _Told, seen: set[int]) -> None:
    """Everything that `new` is made of, from the same of the part."""
    seen.add(id(new))
    for name, own in vars(new).items():
        old, built = vars(part.old)[name], vars(part.built)[name]
        if all(isinstance(one, np.ndarray) for one in (own, old, built)):
            if own.ndim and not _same(old, built):
                _copy(own, old, _places(new, part, axes), f"{type(new).__name__}.{name}")
        elif all(isinstance(one, _NUMBERS) for one in (own, old, built)):
            _, changed = told.setdefault((id(new), name), (new, []))
            changed += [] if _same(old, built) else [old]
        else:
            for piece, its_old, its_built in _pieces(own, old, built):
                if id(piece) not in seen:
                    _move(piece, Part(its_old, its_built, part.rows), axes, told, seen)


def _pieces(own: Any, old: Any, built: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Objects of ours, side by side: these three, or those in three lists."""
    if isinstance(own, list):
        for three in zip(own, old, built, strict=False):
            yield from _pieces(*three)
    elif type(own).__module__.startswith("softplc.") and hasattr(own, "__dict__") and old is not None:
        yield own, old, built  # None where a part has no axis of that kind


def _places(new: Any, part: Part, axes: int) -> Iterator[tuple[int, int, NDArray[np.intp]]]:
    """What the last dimension of an array may be: how many in the old, how many in the new, and where there."""
    yield len(part.rows), axes, part.rows
    for some, all_of_them in zip(getattr(part.old, "chosen", ()), getattr(new, "chosen", ()), strict=True):
        yield len(some), len(all_of_them), np.searchsorted(all_of_them, part.rows[some])


def _copy(into: Any, old: Any, places: Iterator[tuple[int, int, NDArray[np.intp]]], name: str) -> None:
    *longest, last = into.shape
    for count, wanted, where in places:
        fits = all(mine >= its for mine, its in zip(longest, old.shape[:-1], strict=True))  # what is beyond it is 0
        if fits and (count, wanted) == (old.shape[-1], last):
            into[(*(slice(size) for size in old.shape[:-1]), where)] = old
            return
    raise UnlikeError(f"{name} is of {old.shape}; expected it to fit into {into.shape}")


def _same(old: Any, built: Any) -> bool:
    return np.array_equal(old, built, equal_nan=True)
