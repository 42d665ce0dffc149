"""Gains and covariances of many AOIs after so many scans that they have settled, in one batch."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.reference.aoi_options import AoiOptions


def settled(
    q_x: ArrayLike,
    q_x_dot: ArrayLike,
    r_x: ArrayLike,
    dt: ArrayLike,
    options: AoiOptions | None = None,
    scans: int = 8_000,
) -> batch.AoiBatchState:
    """The state after `scans` scans at a constant dt in seconds; the arguments broadcast against each other."""
    q_x, q_x_dot, r_x, dt = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(one, float)) for one in (q_x, q_x_dot, r_x, dt))
    )
    n = len(dt)
    tuning = batch.AoiTuning(
        np.float64,
        q_x=q_x,
        q_x_dot=q_x_dot,
        r_x=r_x,
        BleedEnable=np.zeros(n, bool),
        BleedThresh=np.zeros(n),
        BleedFactor=np.ones(n),
        options=AoiBatchOptions(np.float64, [options] * n) if options else None,
    )
    state, every = batch.AoiBatchState(n), np.full(n, True)
    for _ in range(scans):
        batch.step(state, tuning, EnableIn=every, x=np.zeros(n), dt=1000.0 * dt, rows=every)
    return state


def slowest_time_constant(K0: float, K1: float, dt: float) -> float:
    """Seconds of the slowest pole of an observer with these gains at dt seconds."""
    slowest = np.abs(np.roots([1.0, -(2.0 - K0 - dt * K1), 1.0 - K0])).max()
    return -dt / math.log(slowest)


def riccati(F: NDArray[np.float64], Q: NDArray[np.float64], R: float) -> NDArray[np.float64]:
    """The predicted covariance that P = F(P − PHᵀ(HPHᵀ + R)⁻¹HP)Fᵀ + Q settles at, H = [1, 0], by doubling.

    Structure-preserving doubling (B. D. O. Anderson, "Second-order convergent algorithms for the steady-state
    Riccati equation", 1978): the k-th step is the recursion after 2^k scans.
    """
    A, G, H = F.T.copy(), np.array([[1.0 / R, 0.0], [0.0, 0.0]]), Q.copy()
    one = np.eye(2)
    for _ in range(60):
        W = np.linalg.inv(one + G @ H)
        A, G, H = A @ W @ A, G + A @ W @ G @ A.T, H + A.T @ H @ W @ A
    return H
