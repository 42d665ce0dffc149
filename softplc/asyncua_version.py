"""With which asyncua the fast paths of the OPC-UA client and server may be used."""

import functools
from importlib import metadata
from typing import Final

import structlog

PROVEN: Final = frozenset({"2.1.0"})
"""Versions of asyncua whose codec, messages, channels and subscriptions our fast paths were compared with."""

log = structlog.get_logger(__name__)


@functools.cache
def proven(who: str, version: str | None = None) -> bool:
    """True when a fast path may be used with this asyncua, by default the installed; the log tells it once."""
    found = version or metadata.version("asyncua")
    if found not in PROVEN:
        log.warning(
            "OPC-UA messages are coded value by value, at many times the cost: not proven on this asyncua",
            by=who,
            found=found,
            expected=" or ".join(sorted(PROVEN)),
        )
    return found in PROVEN
