"""What works in a configuration, but not as one would wish: no error, but worth a sentence at its start."""

from collections.abc import Iterator
from typing import Final

from softplc.config.axis import Axis
from softplc.config.models import Config
from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.signal_config import Signal

_COUNTS_OF_A_REAL: Final = 2.0**24
_NEARLY: Final = 0.999  # a value that was worked out by hand and rounded is not too small


def remarks(config: Config) -> list[str]:
    """One text for each remark, with the name of its axis."""
    return [f"{axis.name}: {text}" for axis in config.axes for text in _of(axis)]


def _of(axis: Axis) -> Iterator[str]:
    observer = axis.observer
    if isinstance(observer, AoiConfig):
        yield from observer.remarks
    if axis.signal is not None:
        yield from _of_signal(axis, axis.signal)
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


def _of_signal(axis: Axis, signal: Signal) -> Iterator[str]:
    observer = axis.observer
    if signal.quantum is not None and getattr(observer, "r_mode", "per_sample") == "per_sample":
        least = signal.quantum * signal.quantum / 12.0
        for key, power in (("r_x", 1), ("R", 1), ("sigma_v", 2)):
            noise = getattr(observer, key, None)
            if noise is None or max(noise**power, getattr(observer, "min_r", None) or 0.0) >= least * _NEARLY:
                continue
            what = f"{key} {noise:g} is less than steps of {signal.quantum:g} make by themselves"
            yield f"{what}, quantum²/12; set it to {least ** (1.0 / power):.3g} or more"
    top_speed = observer.top_speed if isinstance(observer, AdaptiveConfig) else 0.0
    if signal.max_rate is not None and signal.max_rate < top_speed:
        yield (
            f"signal.max_rate {signal.max_rate:g} is less than the observer's top_speed {top_speed:g}; "
            "samples of an axis at that speed would be rejected"
        )
