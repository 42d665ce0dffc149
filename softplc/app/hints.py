"""What `check --connect` says of values that were read well and cannot be meant."""

import asyncio
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from softplc.clock import Clock
from softplc.drivers.modbus.config import ModbusSource, ModbusTag
from softplc.drivers.modbus.hints import MOST, Alternative, Range, better, candidates, makes_sense
from softplc.errors import LinkError
from softplc.sample import StatusCode
from softplc.tags import Image

_APART: Final = 0.2  # seconds between two reads of an alternative
_AHEAD: Final = 1.0


@dataclass(slots=True)
class Looked:
    """One tag that was looked at for a while: its values, `limits` of its axis, seconds ahead of our clock."""

    name: str
    tag: Any
    limits: Range
    values: list[float] = field(default_factory=list)
    ahead: float = 0.0


async def hints(source: Any, looked: Sequence[Looked], clock: Clock, period: float) -> list[str]:
    """One text for each tag whose values make no sense, with what would; other drivers' tags by their range alone."""
    texts = [
        f"{each.name}: its timestamp is {each.ahead:.3g} s ahead of our clock"
        for each in looked
        if each.ahead > _AHEAD
    ]
    odd: list[Looked] = []
    for each in looked:
        known = [value for value in each.values if not math.isnan(value)]
        if isinstance(each.tag, ModbusTag):
            if each.values and not makes_sense(each.tag, each.values, each.limits):
                odd.append(each)
        elif each.limits is not None and any(not each.limits[0] <= value <= each.limits[1] for value in known):
            texts.append(_found(each))
    if not odd or not isinstance(source, ModbusSource):
        return texts
    return texts + await _instead(source, odd, clock, period)


async def _instead(source: ModbusSource, odd: Sequence[Looked], clock: Clock, period: float) -> list[str]:
    asked: list[tuple[Looked, Alternative]] = [
        (each, alternative)
        for each in odd
        for alternative in candidates(each.tag, source.byte_order, each.values, each.limits)
    ]
    reads = (
        [] if not asked else await _read_twice(source, [alternative.tag for _, alternative in asked], clock, period)
    )
    told = {each.name: list[str]() for each in odd}
    for (each, alternative), values in zip(asked, reads, strict=True):
        if better(each.tag, alternative, values, each.limits):
            told[each.name].append(f"{alternative.change} reads {values[-1]:.6g}")
    return [
        _found(each) + "".join(f"; {text}" for text in told[each.name][:MOST])
        for each in odd
        if told[each.name] or each.limits is not None or not all(map(math.isfinite, each.values))
    ]


async def _read_twice(
    source: ModbusSource, tags: Sequence[ModbusTag], clock: Clock, period: float
) -> list[list[float]]:
    """The values of all tags in two reads, NaN where the device gives none."""
    unique = list(dict.fromkeys(tags))
    driver = source.build(unique, [], clock, period)
    found: list[list[float]] = [[] for _ in unique]
    try:
        async with asyncio.timeout(source.connect_timeout_ms / 1e3):
            await driver.open()
            for _ in range(2):
                await clock.sleep_until(clock.monotonic() + _APART)
                image = Image(len(unique))
                await driver.read(image)
                for values, value in zip(found, image.values.tolist(), strict=True):
                    values.append(value)
    except (LinkError, TimeoutError):
        pass  # the device gives what is configured and no more
    finally:
        await driver.close()
    by_tag = dict(zip(unique, found, strict=True))
    return [by_tag[tag] for tag in tags]


def _found(each: Looked) -> str:
    value = each.values[-1] if each.values else math.nan
    what = f"{each.name}: {each.tag} reads {value:.6g}"
    return what if each.limits is None else f"{what}, the axis' range is {each.limits[0]:g} … {each.limits[1]:g}"


def usable(image: Image, position: int) -> bool:
    """The source gave a value that it does not call Bad."""
    return bool(image.statuses[position] < StatusCode.BAD)
