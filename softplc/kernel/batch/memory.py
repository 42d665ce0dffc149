"""Where the arrays of a batch begin: at a cache line, else each of their vectors may lie across two of them."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

_LINE = 64  # bytes


def aligned(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Zeros in C order whose first one lies at the beginning of a cache line."""
    wanted = np.dtype(dtype)
    size = wanted.itemsize * int(np.prod(shape))
    memory = np.zeros(size + _LINE, np.uint8)
    first = -memory.ctypes.data % _LINE
    return memory[first : first + size].view(wanted).reshape(shape)
