"""Where the AOI's gains settle at a constant time step, in closed form: from then on it is an α-β filter."""

import math


def steady_gains(q_x: float, q_x_dot: float, r_x: float, dt_s: float) -> tuple[float, float]:
    """K0 and K1 (1/s) that the AOI converges to for noise per scan, r_x > 0 and dt_s > 0 in seconds.

    λ = Δt·√(q_x_dot/r_x), μ = q_x/r_x, w = (λ + √(λ² + 16 + 4μ))/2, s = (w − √(λw + μ))/2,
    K0 = 1 − s², K1 = √(q_x_dot/r_x)·s: the stabilising solution of the discrete Riccati equation with
    F = [[1, Δt], [0, 1]], H = [1, 0], Q = diag(q_x, q_x_dot), R = r_x. q_x in u², q_x_dot in (u/s)², r_x in u².
    Raises ValueError for a negative q or where r_x or dt_s is not above zero.
    """
    if not (q_x >= 0.0 and q_x_dot >= 0.0 and r_x > 0.0 and dt_s > 0.0):
        found = f"found q_x {q_x}, q_x_dot {q_x_dot}, r_x {r_x}, dt_s {dt_s}"
        raise ValueError(f"{found}; expected both q at least 0, r_x and dt_s above 0")
    rate = math.sqrt(q_x_dot / r_x)
    lam = dt_s * rate
    mu = q_x / r_x
    w = (lam + math.sqrt(lam * lam + 16.0 + 4.0 * mu)) / 2.0
    s = (w - math.sqrt(lam * w + mu)) / 2.0
    return 1.0 - s * s, rate * s
