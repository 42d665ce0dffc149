"""What the simple observers share in scalar form: numbers that never raise, in double or single precision."""

from collections.abc import Callable
from typing import Any

import numpy as np

Number = Any  # a scalar of numpy, float64 or float32, which divides by zero without raising
Precision = Callable[[float], Number]

LREAL: Precision = np.float64
REAL: Precision = np.float32
