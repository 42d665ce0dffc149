"""What works in a configuration, but not as one would wish: no error, but worth a sentence at its start."""

from collections.abc import Iterator
from typing import Final

from softplc.config.axis import Axis
from softplc.config.models import Config
from softplc.observers.aoi import AoiConfig

_COUNTS_OF_A_REAL: Final = 2.0**24


def remarks(config: Config) -> list[str]:
    """One text for each remark, with the name of its axis."""
    return [f"{axis.name}: {text}" for axis in config.axes for text in _of(axis)]


def _of(axis: Axis) -> Iterator[str]:
    observer = axis.observer
    if isinstance(observer, AoiConfig):
        yield from observer.remarks
    farthest = max(abs(limit) for limit in axis.range or (0.0,))
    if getattr(observer, "precision", "lreal") == "real" and farthest > _COUNTS_OF_A_REAL:
        if not isinstance(observer, AoiConfig):
            cure = "set precision: lreal"
        elif observer.reference is None:
            cure = "set reference, or precision: lreal"
        else:
            return
        loss = f"precision: real at positions up to {farthest:g} loses single counts, and the velocity with them"
        yield f"{loss}; {cure}"
