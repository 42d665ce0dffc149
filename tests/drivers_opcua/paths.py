"""The three ways of a value into a scan: polled with our codec, polled with asyncua's, and subscribed."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from softplc import asyncua_version

PATHS = ("poll, our codec", "poll, asyncua's codec", "subscribe")
every_path = pytest.mark.parametrize("path", PATHS)


@contextmanager
def on(path: str) -> Iterator[str]:
    """The mode of this way; where asyncua is to decode, it counts as one that our codec was not compared with."""
    plain = path == PATHS[1]
    asyncua_version.proven.cache_clear()
    with pytest.MonkeyPatch.context() as patch:
        if plain:
            patch.setattr(asyncua_version, "PROVEN", frozenset({"0.0.1"}))
        try:
            yield "subscribe" if path == PATHS[2] else "poll"
        finally:
            asyncua_version.proven.cache_clear()
