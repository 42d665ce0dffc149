"""The arithmetic of the observers, usable without any server: no clock, no log, no I/O, numpy and nothing else.

Scalars, one function block at a time, beside the Structured Text (docs/kalman_by_hand.py walks through it):

>>> from softplc.kernel import AoiInputs, AoiState, aoi_lreal
>>> state = AoiState()
>>> for z in (0.0, 1.0, 2.0):  # measured position, unit u; dt in ms; variances per scan and per sample
...     state, result = aoi_lreal(state, AoiInputs(True, z, dt=50.0, q_x=0.01, q_x_dot=0.1, r_x=4 / 3))
>>> round(state.y, 6), round(state.y_dot, 6)  # u, u/s
(0.811503, 1.299997)

A recording in one call, any number of axes side by side, bit-equal to the scalars; x is [t] or [t, axis]:

>>> from softplc.kernel import AoiTuning, run_aoi
>>> bleed = {"BleedEnable": [False], "BleedThresh": [0.0], "BleedFactor": [1.0]}
>>> tuning = AoiTuning("f8", q_x=[0.01], q_x_dot=[0.1], r_x=[4 / 3], **bleed)
>>> run_aoi(tuning, x=[0.0, 1.0, 2.0], dt=50.0, backend="numpy")["y"].round(6).tolist()
[0.0, 0.326312, 0.811503]

| package | what is in it |
|---|---|
| `softplc.kernel.reference` | one module for each observer: the specification, as scalars |
| `softplc.kernel.batch` | the same names on arrays, one row for each axis: what the service steps |
| `softplc.kernel.compiled` | the AOI's batch compiled with numba, where the extra `compiled` is installed |
| `softplc.kernel.offline` | `run` takes a recording through any batch kernel |
"""

from softplc.kernel.batch.adaptive import AdaptiveBatchState
from softplc.kernel.batch.adaptive_hypotheses import AdaptiveTuning
from softplc.kernel.batch.alpha_beta import AlphaBetaBatchState, AlphaBetaTuning
from softplc.kernel.batch.aoi import AoiBatchState, AoiTuning
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.batch.cv_accel import CvAccelBatchState, CvAccelTuning
from softplc.kernel.batch.derivative import DerivativeBatchState, DerivativeTuning
from softplc.kernel.batch.dhvpo import DhvpoBatch
from softplc.kernel.batch.ducekf_state import DucekfBatchState, DucekfBatchTuning
from softplc.kernel.batch.end_stops import EndStopsBatch
from softplc.kernel.batch.fb_kalman import FbKalmanBatchState, FbKalmanTuning
from softplc.kernel.batch.finite_difference import FiniteDifferenceBatchState, FiniteDifferenceTuning
from softplc.kernel.batch.moving_average import MovingAverageBatchState, MovingAverageTuning
from softplc.kernel.batch.one_euro import OneEuroBatchState, OneEuroTuning
from softplc.kernel.offline import run, run_aoi
from softplc.kernel.reference.adaptive import AdaptiveInputs, AdaptiveState, adaptive
from softplc.kernel.reference.alpha_beta import AlphaBetaInputs, AlphaBetaState, alpha_beta_lreal, alpha_beta_real
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal, aoi_real
from softplc.kernel.reference.aoi_options import AoiOptions, AoiOptionsState, aoi_options_lreal, aoi_options_real
from softplc.kernel.reference.cv_accel import CvAccelInputs, CvAccelState, cv_accel
from softplc.kernel.reference.derivative import DerivativeInputs, DerivativeState, derivative_lreal, derivative_real
from softplc.kernel.reference.dhvpo import Dhvpo, PlantRule, PlantState, plant_step
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, DucekfTuning, ducekf, ducekf_start
from softplc.kernel.reference.end_stops import EndStops
from softplc.kernel.reference.fb_kalman import (
    FbKalmanInputs,
    FbKalmanState,
    fb_kalman_corrected_lreal,
    fb_kalman_corrected_real,
    fb_kalman_lreal,
    fb_kalman_real,
)
from softplc.kernel.reference.finite_difference import (
    FiniteDifferenceInputs,
    FiniteDifferenceState,
    finite_difference,
)
from softplc.kernel.reference.moving_average import MovingAverageInputs, MovingAverageState, moving_average
from softplc.kernel.reference.one_euro import OneEuroInputs, OneEuroState, one_euro
from softplc.kernel.result import Result
from softplc.kernel.steady import steady_gains

__all__ = [
    "AdaptiveBatchState",
    "AdaptiveInputs",
    "AdaptiveState",
    "AdaptiveTuning",
    "AlphaBetaBatchState",
    "AlphaBetaInputs",
    "AlphaBetaState",
    "AlphaBetaTuning",
    "AoiBatchOptions",
    "AoiBatchState",
    "AoiInputs",
    "AoiOptions",
    "AoiOptionsState",
    "AoiState",
    "AoiTuning",
    "CvAccelBatchState",
    "CvAccelInputs",
    "CvAccelState",
    "CvAccelTuning",
    "DerivativeBatchState",
    "DerivativeInputs",
    "DerivativeState",
    "DerivativeTuning",
    "Dhvpo",
    "DhvpoBatch",
    "DucekfBatchState",
    "DucekfBatchTuning",
    "DucekfInputs",
    "DucekfState",
    "DucekfTuning",
    "EndStops",
    "EndStopsBatch",
    "FbKalmanBatchState",
    "FbKalmanInputs",
    "FbKalmanState",
    "FbKalmanTuning",
    "FiniteDifferenceBatchState",
    "FiniteDifferenceInputs",
    "FiniteDifferenceState",
    "FiniteDifferenceTuning",
    "MovingAverageBatchState",
    "MovingAverageInputs",
    "MovingAverageState",
    "MovingAverageTuning",
    "OneEuroBatchState",
    "OneEuroInputs",
    "OneEuroState",
    "OneEuroTuning",
    "PlantRule",
    "PlantState",
    "Result",
    "adaptive",
    "alpha_beta_lreal",
    "alpha_beta_real",
    "aoi_lreal",
    "aoi_options_lreal",
    "aoi_options_real",
    "aoi_real",
    "cv_accel",
    "derivative_lreal",
    "derivative_real",
    "ducekf",
    "ducekf_start",
    "fb_kalman_corrected_lreal",
    "fb_kalman_corrected_real",
    "fb_kalman_lreal",
    "fb_kalman_real",
    "finite_difference",
    "moving_average",
    "one_euro",
    "plant_step",
    "run",
    "run_aoi",
    "steady_gains",
]
