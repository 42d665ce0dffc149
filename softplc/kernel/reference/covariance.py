"""How the covariance of two states moves: through a step of the smooth branch, and through an impact.

Equation numbers as in `kernel.reference.ducekf`. Matrices are row-major: P00, P01, P10, P11.
"""

from typing import Literal

Matrix = tuple[float, float, float, float]

ImpactCovariance = Literal["omega", "saltation", "none"]


def propagate(A: Matrix, P: Matrix) -> Matrix:
    """APAᵀ, (4)."""
    a00, a01, a10, a11 = A
    P00, P01, P10, P11 = P
    b00 = a00 * P00 + a01 * P10
    b01 = a00 * P01 + a01 * P11
    b10 = a10 * P00 + a11 * P10
    b11 = a10 * P01 + a11 * P11
    return (b00 * a00 + b01 * a01, b00 * a10 + b01 * a11, b10 * a00 + b11 * a01, b10 * a10 + b11 * a11)


def impact_covariance(P: Matrix, covariance: ImpactCovariance, m0: float, m1: float) -> Matrix:
    """P after a transition with the Jacobian diag(m0, m1), entry ij times d_i·d_j.

    omega: d = 1/m, so that ÃᵀP⁺Ã = P, (24), (28), (29); undefined where κ = 0, saltation takes its place there.
    saltation: d = m, P⁺ = ÃPÃᵀ. none: P as it was.
    """
    if covariance == "none":
        return P
    if covariance == "omega" and m1 != 0.0:
        m0, m1 = 1.0 / m0, 1.0 / m1
    P00, P01, P10, P11 = P
    return ((m0 * m0) * P00, (m0 * m1) * P01, (m0 * m1) * P10, (m1 * m1) * P11)
