"""Compiling before use: nothing that runs in a scan may be compiled there."""

from collections.abc import Callable
from typing import Any

from numba import njit


def compile_now(function: Callable[..., Any], signature: tuple[Any, ...]) -> tuple[Any, bool]:
    """The function compiled for these numba types and no others, and whether an earlier process had compiled it.

    Takes seconds otherwise. What was compiled is kept in the __pycache__ beside the source, else in the user's cache
    folder, or where NUMBA_CACHE_DIR says; where none of them can be written, each process compiles anew. A call with
    other types is a TypeError.
    """
    try:
        compiled = njit(function, cache=True, error_model="numpy")
    except RuntimeError:  # numba found no place to keep it
        compiled = njit(function, error_model="numpy")
    compiled.compile(signature)
    compiled.disable_compile()
    return compiled, bool(compiled.stats.cache_hits)


def inlined(function: Callable[..., Any]) -> Any:
    """A numba function that is a part of those which call it."""
    return njit(function, error_model="numpy")
