"""Arrays of a batch begin at a cache line."""

import numpy as np
import pytest

from softplc.kernel.batch.aoi import AoiBatchState
from softplc.kernel.batch.memory import aligned
from softplc.kernel.reference.aoi import AoiInputs
from tests.kernel.sequences import tuning_of


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1,), (13, 7), (5, 0)])
def test_an_aligned_array_is_zeros_in_c_order_that_may_be_written(dtype: type, shape: tuple[int, ...]):
    array = aligned(shape, dtype)

    assert (array.shape, array.dtype, array.any()) == (shape, np.dtype(dtype), False)
    assert array.flags.c_contiguous
    assert array.flags.writeable
    assert array.ctypes.data % 64 == 0 or array.size == 0


def test_states_and_tunings_begin_at_a_cache_line_so_that_no_vector_lies_across_two():
    starts = []
    for n in range(1, 20):
        state, tuning = AoiBatchState(n), tuning_of([AoiInputs(True, 0.0, 50.0, 1.0, 1.0, 1.0)] * n, "lreal")
        starts += [state.numbers.ctypes.data % 64, tuning.numbers.ctypes.data % 64]

    assert set(starts) == {0}
