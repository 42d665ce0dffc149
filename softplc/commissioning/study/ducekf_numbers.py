"""The DUCEKF paper's case study in numbers: Table 1, run with the kernel's oscillator and filter."""

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, get_args

import numpy as np

from softplc.commissioning.study.ducekf_noise import Consistency, consistency
from softplc.commissioning.study.ducekf_timing import ITERATIONS, PROCESSES_US, Clock, Timing, measure
from softplc.kernel.reference.dhvpo import TABLE_1, Dhvpo, PlantRule, Scan, StepRule, run
from softplc.kernel.reference.ducekf import Band

LONG = 1400  # iterations: four impacts
KAPPA, KAPPA_EKF = 0.5, 1.5  # of Table 1; of the comparison with the EKF
HOLD_START, HOLD_R = (0.3, 1.5), 1e3  # x̂0 ahead of the oscillator, and a filter that hardly listens
CONVERGED = 0.015  # u/s
RUNS = 120


@dataclass(frozen=True, slots=True)
class Impact:
    """One impact: V = eᵀPe before it and how it changes, for the DUCEKF and for the EKF, whose P stays.

    `rounding` is the part of V that the last bits of x(2) and x̂(2) make up, once e = x − x̂ has become small.
    """

    k: int
    ducekf: float
    ekf: float
    ducekf_before: float
    ekf_before: float
    rounding: float


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read step rule, activation set and moment of the transition, with the impacts within k = 1 000."""

    step: str
    edge: str
    judged: str
    impacts: list[int]


@dataclass(frozen=True, slots=True)
class MatrixProduct:
    """Ω at the first impact, once entry by entry and once as a matrix product: largest |ÃᵀP⁺Ã − P|, P01⁺ and P10⁺."""

    elementwise_29: float
    product_29: float
    product_P01: float
    product_P10: float
    product_determinant: float


@dataclass(frozen=True, slots=True)
class DucekfNumbers:
    """All of it; `to_json` leaves the scans out."""

    seed: int
    scans: list[Scan]
    unstable: list[Scan]  # κ = 1.5
    hold: list[Scan]
    lyapunov: list[Impact]  # κ = 1.5
    lyapunov_soft: list[Impact]  # κ = 0.5
    readings: list[Reading]
    product: MatrixProduct
    converged: int
    noise: list[Consistency]
    timing: Timing

    @property
    def impacts(self) -> list[int]:
        """Iterations of all impacts, κ = 0.5."""
        return _impacts(self.scans)

    @property
    def unstable_impacts(self) -> list[int]:
        """Iterations of all impacts, κ = 1.5."""
        return _impacts(self.unstable)

    @property
    def held(self) -> list[int]:
        """Iterations of the hold scenario in which the estimate waits."""
        return [scan.k for scan in self.hold if scan.held]

    def to_json(self) -> dict[str, Any]:
        """The numbers without the scans; `timing` is this machine's, all else is the same anywhere."""
        before, impact = self.scans[self.impacts[0] - 2], self.scans[self.impacts[0] - 1]
        return {
            "paths": [
                {"first": path.first, "last": path.last, "routes": list(path.routes), "quantity": path.quantity}
                for path in self.timing.paths
            ],
            "impacts": {"kappa_0.5": self.impacts, "kappa_1.5": self.unstable_impacts},
            "first_impact": {
                "x": list(impact.x),
                "x_hat": list(impact.x_hat),
                "P_before": list(before.P),
                "P_after": list(impact.P),
            },
            "convergence": {
                "x_hat_1": list(self.scans[0].x_hat),
                "velocity_error_below_0.015_from": self.converged,
                "velocity_error_100": velocity_error(self.scans[99]),
                "velocity_error_314": velocity_error(self.scans[313]),
            },
            "lyapunov": {
                "kappa_1.5": [asdict(one) for one in self.lyapunov],
                "kappa_0.5": [asdict(one) for one in self.lyapunov_soft],
            },
            "omega": asdict(self.product),
            "hold": {
                "first": self.held[0],
                "last": self.held[-1],
                "scans": len(self.held),
                "impacts": _impacts(self.hold),
            },
            "readings": [asdict(reading) for reading in self.readings],
            "consistency": [asdict(one) for one in self.noise],
            "paper_statistics": asdict(self.timing.paper),
            "timing": {
                "processes_us": {
                    "main_algorithm": self.timing.here.mean,
                    "output": self.timing.output_us,
                    "paper": list(PROCESSES_US),
                },
                "paths_us": [path.here_us for path in self.timing.paths],
                "statistics": asdict(self.timing.here),
            },
        }


def experiment(seed: int, clock: Clock) -> DucekfNumbers:
    """Run it. The seed is that of the Monte Carlo part; everything else is without noise, as in the paper."""
    scans = run(LONG, Dhvpo(kappa=KAPPA))
    unstable = run(LONG, Dhvpo(kappa=KAPPA_EKF))
    return DucekfNumbers(
        seed=seed,
        scans=scans,
        unstable=unstable,
        hold=run(ITERATIONS, tuning=replace(TABLE_1, r_x=HOLD_R), x0_hat=HOLD_START),
        lyapunov=_lyapunov(unstable, run(LONG, Dhvpo(kappa=KAPPA_EKF), replace(TABLE_1, covariance="none"))),
        lyapunov_soft=_lyapunov(scans, run(LONG, Dhvpo(kappa=KAPPA), replace(TABLE_1, covariance="none"))),
        readings=[
            Reading(step, edge, judged, _impacts(run(1000, rule=PlantRule(step=step, edge=edge, judged=judged))))
            for step in get_args(StepRule)
            for edge in get_args(Band)
            for judged in ("carried", "same")
        ],
        product=_matrix_product(scans),
        converged=_converged(scans),
        noise=consistency(seed, RUNS),
        timing=measure(clock),
    )


def velocity_error(scan: Scan) -> float:
    """x(2) − x̂(2)."""
    return scan.x[1] - scan.x_hat[1]


def _impacts(scans: Sequence[Scan]) -> list[int]:
    return [scan.k for scan in scans if scan.impact]


def _converged(scans: Sequence[Scan]) -> int:
    """From which k on the velocity error stays below 0.015."""
    return max((scan.k + 1 for scan in scans if abs(velocity_error(scan)) >= CONVERGED), default=1)


def _lyapunov(ducekf: Sequence[Scan], ekf: Sequence[Scan]) -> list[Impact]:
    """The first three impacts: at the fourth the error has shrunk to the last bits."""
    return [
        Impact(
            k,
            ducekf[k - 1].delta_v,
            ekf[k - 1].delta_v,
            _v(ducekf[k - 2]),
            _v(ekf[k - 2]),
            8.0 * sys.float_info.epsilon * abs(ducekf[k - 2].x[1] / velocity_error(ducekf[k - 2])),
        )
        for k in _impacts(ducekf)[:3]
    ]


def _v(scan: Scan) -> float:
    """V = eᵀPe, (21)."""
    e1, e2 = scan.x[0] - scan.x_hat[0], scan.x[1] - scan.x_hat[1]
    P00, P01, P10, P11 = scan.P
    return e1 * (P00 * e1 + P01 * e2) + e2 * (P10 * e1 + P11 * e2)


def _matrix_product(scans: Sequence[Scan]) -> MatrixProduct:
    """(18), (28) and (30) at the first impact."""
    k = _impacts(scans)[0]
    P = np.array(scans[k - 2].P).reshape(2, 2)
    omega = np.array([[1.0, -1.0 / KAPPA], [-1.0 / KAPPA, 1.0 / KAPPA**2]])
    A = np.diag([1.0, -KAPPA])
    product = omega @ P
    return MatrixProduct(
        elementwise_29=float(np.abs(A.T @ (omega * P) @ A - P).max()),
        product_29=float(np.abs(A.T @ product @ A - P).max()),
        product_P01=float(product[0, 1]),
        product_P10=float(product[1, 0]),
        product_determinant=float(np.linalg.det(product)),
    )
