"""The arithmetic of the observers, usable without any server: no clock, no log, no I/O, numpy and nothing else.

Scalars, one function block at a time, beside the Structured Text:

>>> from softplc.kernel import AoiInputs, AoiState, aoi_lreal
>>> state = AoiState()
>>> for z in (0.0, 1.0, 2.0):  # measured position, unit u; dt in ms; variances per scan and per sample
...     state, result = aoi_lreal(state, AoiInputs(True, z, dt=50.0, q_x=0.01, q_x_dot=0.1, r_x=4 / 3))
>>> round(state.y, 6), round(state.y_dot, 6)  # u, u/s
(0.811503, 1.299997)

Arrays, one row for each axis, live in `softplc.kernel.batch`, bit-equal to the scalars.
"""

from softplc.kernel.batch.aoi import AoiBatchState, AoiTuning
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real
from softplc.kernel.result import Result
from softplc.kernel.steady import steady_gains

__all__ = [
    "AoiBatchState",
    "AoiInputs",
    "AoiState",
    "AoiTuning",
    "Result",
    "aoi_lreal",
    "aoi_real",
    "steady_gains",
]
