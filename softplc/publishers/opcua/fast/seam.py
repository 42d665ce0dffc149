"""With which asyncua the fast path may be used."""

import functools
from importlib import metadata
from typing import Final

import structlog

PROVEN: Final = frozenset({"2.1.0"})
"""Versions of asyncua whose bodies of messages, subscriptions and codec this folder was compared with."""

log = structlog.get_logger(__name__)


@functools.cache
def proven(version: str | None = None) -> bool:
    """True when the fast path may be used with this asyncua, by default the installed; the log tells once if not."""
    found = version or metadata.version("asyncua")
    if found not in PROVEN:
        log.warning(
            "opcua server codes value by value, at many times the cost: not proven on this asyncua",
            found=found,
            expected=" or ".join(sorted(PROVEN)),
        )
    return found in PROVEN
