"""The sixteen hypotheses of each axis on arrays [what, hypothesis, axis]: births, prediction, weights.

The operations of `kernel.reference.adaptive_hypothesis` in the same order.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.reference.adaptive_hypothesis import (
    BIRTHS,
    CHANGE,
    CREEP,
    CRUISE,
    DWELL,
    HOLD,
    JERK,
    JUMP,
    KEPT,
    MANOEUVRE,
    SWAY,
    SWING,
    SWING_BEGINS,
    SWING_ENDS,
    SWING_JERK,
    SWINGS,
    TO_CRUISE,
    TO_OTHER,
    TO_REST,
)

Numbers = NDArray[Any]  # float64[n]
Flags = NDArray[np.bool_]

ALL: Final = KEPT + BIRTHS
AT_W, AT_X, AT_V, AT_A, AT_P00, AT_P01, AT_P02, AT_P11, AT_P12, AT_P22 = range(10)  # rows of a hypothesis
AT_NU, AT_S, AT_WEIGHT = range(10, 13)  # and of the scratch
OUTPUTS: Final = (
    *("y", "y_dot", "y_ddot", "y_res", "S", "K0", "K1", "P00", "P01", "P11"),
    *("hold", "cruise", "manoeuvre"),
)


class AdaptiveTuning:
    """Arrays[n]: `r_x` in u² per sample, `top_speed` in u/s, `top_acceleration` in u/s², `gate` in √S."""

    def __init__(
        self,
        dtype: DTypeLike = np.float64,
        *,
        r_x: ArrayLike,
        top_speed: ArrayLike,
        top_acceleration: ArrayLike,
        gate: ArrayLike,
    ) -> None:
        self.r_x: Numbers = np.array(r_x, dtype)
        self.top_speed: Numbers = np.array(top_speed, dtype)
        self.top_acceleration: Numbers = np.array(top_acceleration, dtype)
        self.gate: Numbers = np.array(gate, dtype)


class Scratch:
    """Buffers of one step."""

    def __init__(self, n: int, dtype: np.dtype[Any]) -> None:
        self.axes = np.arange(n)
        self.every: Numbers = np.zeros((13, ALL, n), dtype)
        self.modes: NDArray[np.int8] = np.zeros((ALL, n), np.int8)
        self.modes[KEPT:] = np.array([[HOLD], [CRUISE], [MANOEUVRE], [CRUISE]])  # the births
        self.rates: Numbers = np.zeros((2 + BIRTHS, 4, n), dtype)  # goes on, the four births, and to swing, by mode
        self.noise: Numbers = np.zeros((6, 3 + SWINGS, n), dtype)  # by mode, and of each swing
        self.order = np.tile(np.arange(KEPT)[:, None], (1, n))  # of the kept; the swings are always first
        self.outputs: Numbers = np.zeros((len(OUTPUTS), n), dtype)
        self.result: NDArray[np.uint8] = np.zeros(n, np.uint8)


def rates(scratch: Scratch, tuning: AdaptiveTuning, dt: Numbers) -> None:
    """Probabilities to go on and to change within Δt, by mode."""
    tau = tuning.top_speed / tuning.top_acceleration
    u = dt / (CHANGE * tau)
    g = dt / (DWELL * tau)
    begin = SWING_BEGINS * dt / tau
    end = SWING_ENDS * dt / tau
    ju = JUMP * u
    on, to_rest, to_speed, to_push, to_cruise, to_swing = scratch.rates
    on[HOLD] = 1.0 / (1.0 + ((ju + u) + begin))
    on[CRUISE] = 1.0 / (1.0 + (((ju + ju) + u) + begin))
    on[MANOEUVRE] = 1.0 / (1.0 + (g + begin))
    on[SWING] = 1.0 / (1.0 + end)
    leave = g * on[MANOEUVRE]
    scratch.rates[1 : 1 + BIRTHS, SWING] = (0.25 * end) * on[SWING]
    np.multiply(begin, on[:SWING], out=to_swing[:SWING])
    to_rest[CRUISE] = ju * on[CRUISE]
    to_rest[MANOEUVRE] = TO_REST * leave
    to_speed[HOLD] = ju * on[HOLD]
    to_speed[CRUISE] = to_rest[CRUISE]
    to_push[HOLD] = u * on[HOLD]
    to_push[CRUISE] = u * on[CRUISE]
    to_push[MANOEUVRE] = TO_OTHER * leave
    to_cruise[MANOEUVRE] = TO_CRUISE * leave


def noise(scratch: Scratch, tuning: AdaptiveTuning, dt: Numbers) -> None:
    """Q by mode, as rows Q00, Q01, Q02, Q11, Q12, Q22."""
    A = tuning.top_acceleration
    tau = tuning.top_speed / A
    Q = scratch.noise
    half, square = 0.5 * dt, dt * dt
    third = square / 3.0
    sway = (((SWAY * A) * A) * tau) * dt
    Q[0, HOLD] = (CREEP * tuning.r_x / tau) * dt
    Q[0, CRUISE] = sway * third
    Q[1, CRUISE] = sway * half
    Q[3, CRUISE] = sway
    drift = np.array((JERK, *SWING_JERK))[:, None]
    jerk = (((drift * A) * A) / tau) * dt
    drifting = Q[:, MANOEUVRE:]
    np.multiply(jerk, square * square / 20.0, out=drifting[0])
    np.multiply(jerk, square * dt / 8.0, out=drifting[1])
    np.multiply(jerk, square / 6.0, out=drifting[2])
    np.multiply(jerk, third, out=drifting[3])
    np.multiply(jerk, half, out=drifting[4])
    drifting[5] = jerk


def give_birth(old: Numbers, modes: NDArray[np.int8], scratch: Scratch, tuning: AdaptiveTuning) -> None:
    """The twelve with what is left of their probability, and the four that are mixed of them."""
    every = scratch.every
    flow = by_mode(scratch.rates, modes, scratch.axes)
    every[:10, :KEPT] = old
    scratch.modes[:KEPT] = modes
    np.multiply(old[AT_W], flow[0], out=every[AT_W, :KEPT])
    every[AT_W, :SWINGS] += 0.25 * sum12(old[AT_W] * flow[1 + BIRTHS])

    sources = old[AT_W] * flow[1 : 1 + BIRTHS]  # [births, hypotheses, n]
    w = sum12(sources)
    shares = np.where((w > 0.0)[:, None], sources / w[:, None], 0.0 * sources)
    x = sum12(shares * old[AT_X])
    v = sum12(shares * old[AT_V])
    dx = old[AT_X] - x[:, None]
    dv = old[AT_V] - v[:, None]
    born = every[:, KEPT:]
    born[AT_W] = w
    born[AT_X] = x
    born[AT_V] = v
    born[AT_A] = 0.0
    born[AT_P00] = sum12(shares * (old[AT_P00] + dx * dx))
    born[AT_P01] = sum12(shares * (old[AT_P01] + dx * dv))
    born[AT_P02] = 0.0
    born[AT_P11] = sum12(shares * (old[AT_P11] + dv * dv))
    born[AT_P12] = 0.0
    born[AT_P22] = 0.0
    born[AT_V, :2] = 0.0  # to rest, to another speed
    born[AT_P01, :2] = 0.0
    born[AT_P11, 0] = 0.0
    np.multiply(tuning.top_speed, tuning.top_speed, out=born[AT_P11, 1])
    np.multiply(tuning.top_acceleration, tuning.top_acceleration, out=born[AT_P22, 2])


def predict(scratch: Scratch, dt: Numbers) -> None:
    """State and covariance of all sixteen, Δt later."""
    every = scratch.every
    _, x, v, a, P00, P01, P02, P11, P12, P22 = every[:10]
    Q = by_mode(scratch.noise, scratch.modes, scratch.axes)
    Q[:, :SWINGS] = scratch.noise[:, SWING:]
    h = (0.5 * dt) * dt
    a0 = (P00 + dt * P01) + h * P02
    a1 = (P01 + dt * P11) + h * P12
    a2 = (P02 + dt * P12) + h * P22
    b1 = P11 + dt * P12
    b2 = P12 + dt * P22
    x[:] = (x + dt * v) + h * a
    v[:] = v + dt * a
    P00[:] = ((a0 + dt * a1) + h * a2) + Q[0]
    np.copyto(P00, 0.0, where=P00 < 0.0)  # by rounding
    P01[:] = (a1 + dt * a2) + Q[1]
    P02[:] = a2 + Q[2]
    P11[:] = (b1 + dt * b2) + Q[3]
    P12[:] = b2 + Q[4]
    P22[:] = P22 + Q[5]


def weigh(scratch: Scratch, tuning: AdaptiveTuning, z: Numbers) -> Flags:
    """Innovations, weights, and what was expected over all sixteen; whether the sample is within the gate of one.

    A gentle swing may be anywhere, so it opens no gate.
    """
    every, outputs = scratch.every, scratch.outputs
    w, x, nu, S, weight = (every[row] for row in (AT_W, AT_X, AT_NU, AT_S, AT_WEIGHT))
    np.subtract(z, x, out=nu)
    np.add(every[AT_P00], tuning.r_x, out=S)
    distance = np.where(w > 0.0, nu * nu / S, np.inf)  # what has no probability is never near
    nearest = distance.min(axis=0)

    x16 = sum16(w * x)
    d = x - x16
    outputs[OUTPUTS.index("y_res")] = z - x16
    outputs[OUTPUTS.index("S")] = sum16(w * (S + d * d))

    like = (1.0 + nearest / 64.0) / (1.0 + distance / 64.0)
    for _ in range(5):
        np.multiply(like, like, out=like)  # to the power of 32
    np.multiply(w, like / np.sqrt(S), out=weight)
    within: Flags = distance[SWINGS:].min(axis=0) <= tuning.gate * tuning.gate
    return within


def by_mode(table: Numbers, modes: NDArray[np.int8], axes: NDArray[np.intp]) -> Numbers:
    """table[what, mode, n] → [what, hypothesis, n]."""
    index = modes.astype(np.intp) * len(axes) + axes
    return table.reshape(len(table), -1)[:, index]


def sum12(v: Numbers) -> Numbers:
    """Over the last axis but one, of length 12; numpy's own sum has no fixed order."""
    six = v[..., :6, :] + v[..., 6:, :]
    three = six[..., :3, :] + six[..., 3:, :]
    total: Numbers = (three[..., 0, :] + three[..., 1, :]) + three[..., 2, :]
    return total


def sum16(v: Numbers) -> Numbers:
    """Over the first axis, of length 16."""
    eight = v[:8] + v[8:]
    four = eight[:4] + eight[4:]
    two = four[:2] + four[2:]
    total: Numbers = two[0] + two[1]
    return total
