"""The types for which `compiled.loops` are compiled: numba keeps what it compiled by them."""

from typing import Any

import numpy as np
from numba import types


def scan_signature(dtype: np.dtype[Any]) -> tuple[Any, ...]:
    """The numba types of `scan`'s arguments for a state of this precision."""
    block, flags, numbers = _real(dtype)[:, ::1], types.boolean[::1], types.float64[::1]
    return block, types.uint8[:, ::1], block, flags, flags, numbers, numbers, flags


def replay_signature(dtype: np.dtype[Any]) -> tuple[Any, ...]:
    """The numba types of `replay`'s arguments for a state of this precision."""
    real, flags, table = _real(dtype), types.boolean, types.float64[:, ::1]
    block = real[:, ::1]
    return (
        block, types.uint8[:, ::1], block, flags[::1], flags[:, ::1], table, table, real[:, :, ::1],
        types.uint8[:, ::1],
    )  # fmt: skip


def _real(dtype: np.dtype[Any]) -> Any:
    return types.float32 if dtype == np.float32 else types.float64
