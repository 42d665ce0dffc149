"""The AOI paper's experiment in numbers: what its Figure 2 shows, and what tuning, bleed and precision do to it."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from softplc.commissioning.study.aoi_runs import TUNING, Trace, run, settling_scan, slowest_time_constant
from softplc.commissioning.study.waveform import (
    DT,
    SLOPE,
    Waveform,
    both,
    ramp_hold,
    settled,
    whole,
)
from softplc.kernel.reference.aoi import aoi_real
from softplc.kernel.steady import steady_gains

BLEED_FACTOR = 0.9
BLEED_THRESHOLDS = (0.5, 1.0, 2.0)  # u
RATE_TUNING = (0.001, 0.1, 4.0 / 3.0)  # q_x, q_x_dot, r_x
RATES = (0.002, 0.01, 0.02, 0.05, 0.1)  # s


@dataclass(frozen=True, slots=True)
class SegmentNumbers:
    """The second half of one segment: errors are estimate − truth; `noise_reduction` is std in by std out."""

    kind: str
    velocity_error_mean: float
    velocity_error_std: float
    position_error_mean: float
    position_error_std: float
    noise_reduction: float


@dataclass(frozen=True, slots=True)
class BleedNumbers:
    """One threshold (0: bleed is off); velocity is the mean over both ramps' second halves, true is 10 u/s."""

    threshold: float
    overshoot: float
    velocity_on_ramp: float
    velocity_bias: float
    hold_velocity_std: float
    rmse_position: float
    rmse_velocity: float


@dataclass(frozen=True, slots=True)
class RateNumbers:
    """One time step in s at the same tuning; the scaled columns have q times Δt/50 ms and r times 50 ms/Δt."""

    dt: float
    K0: float
    K1: float
    bandwidth: float
    time_constant: float
    scaled_bandwidth: float
    scaled_time_constant: float


@dataclass(frozen=True, slots=True)
class AoiNumbers:
    """All of it; `to_json` leaves the traces out."""

    seed: int
    wave: Waveform
    trace: Trace
    bled: Trace  # with the first of BLEED_THRESHOLDS
    single: Trace  # in REAL
    steady: tuple[float, float]
    settled_scans: tuple[int, int]
    segments: list[SegmentNumbers]
    overshoots: tuple[float, float]
    quiet_overshoot: float  # of the first stop, without noise
    bleed: list[BleedNumbers]
    rates: list[RateNumbers]

    def single_difference(self) -> tuple[float, float]:
        """Largest |REAL − LREAL| of position and velocity."""
        return (
            float(np.abs(self.single.position - self.trace.position).max()),
            float(np.abs(self.single.velocity - self.trace.velocity).max()),
        )

    def to_json(self) -> dict[str, Any]:
        """The numbers without the traces, under names that say the quantity."""
        position, velocity = self.single_difference()
        return {
            "steady_gains": {
                "K0": float(self.trace.K0[-1]),
                "K1": float(self.trace.K1[-1]),
                "K0_closed_form": self.steady[0],
                "K1_closed_form": self.steady[1],
                "K0_settled_scan": self.settled_scans[0],
                "K1_settled_scan": self.settled_scans[1],
            },
            "segments": [asdict(segment) for segment in self.segments],
            "hold_noise_reduction": hold_noise_reduction(self.wave, self.trace),
            "overshoot": list(self.overshoots),
            "overshoot_without_noise": self.quiet_overshoot,
            "rmse": {
                "position": rmse_position(self.wave, self.trace),
                "velocity": rmse_velocity(self.wave, self.trace),
            },
            "bleed": [asdict(row) for row in self.bleed],
            "scan_rate": [asdict(row) for row in self.rates],
            "single_precision": {"position": position, "velocity": velocity},
            "sanity": {
                "S_min": float(self.trace.S.min()),
                "P00_min": float(self.trace.P00.min()),
                "P11_min": float(self.trace.P11.min()),
                "K0_min": float(self.trace.K0.min()),
                "K0_max": float(self.trace.K0.max()),
            },
        }


def experiment(seed: int) -> AoiNumbers:
    """Run it; the same seed gives the same numbers."""
    wave = ramp_hold(seed)
    trace = run(wave.measured)
    steady = steady_gains(TUNING.q_x, TUNING.q_x_dot, TUNING.r_x, DT)
    bled = [_bled(wave, threshold) for threshold in BLEED_THRESHOLDS]
    return AoiNumbers(
        seed=seed,
        wave=wave,
        trace=trace,
        bled=bled[0],
        single=run(wave.measured, block=aoi_real),
        steady=steady,
        settled_scans=(settling_scan(trace.K0, steady[0]), settling_scan(trace.K1, steady[1])),
        segments=[_segment(wave, trace, segment) for segment in range(4)],
        overshoots=(overshoot(wave, trace.position, 1), overshoot(wave, trace.position, 3)),
        quiet_overshoot=overshoot(wave, run(wave.position).position, 1),
        bleed=[
            _bleed_row(wave, other, threshold)
            for other, threshold in zip([trace, *bled], (0.0, *BLEED_THRESHOLDS), strict=True)
        ],
        rates=[_rate_row(dt) for dt in RATES],
    )


def overshoot(wave: Waveform, position: np.ndarray[Any, Any], hold: int) -> float:
    """How far the estimate goes beyond where the axis stopped, in u; `hold` is segment 1 or 3."""
    scans = whole(hold)
    return float((position[scans] - wave.position[scans]).max())


def hold_noise_reduction(wave: Waveform, trace: Trace) -> float:
    """Standard deviation of the measured by that of the estimated position, in the second halves of both holds."""
    rest = both(1, 3)
    return float(np.std((wave.measured - wave.position)[rest]) / np.std((trace.position - wave.position)[rest]))


def rmse_position(wave: Waveform, trace: Trace) -> float:
    """Over all scans, in u."""
    return float(np.sqrt(np.mean(np.square(trace.position - wave.position))))


def rmse_velocity(wave: Waveform, trace: Trace) -> float:
    """Over all scans, in u/s."""
    return float(np.sqrt(np.mean(np.square(trace.velocity - wave.velocity))))


def _segment(wave: Waveform, trace: Trace, segment: int) -> SegmentNumbers:
    scans = settled(segment)
    velocity = (trace.velocity - wave.velocity)[scans]
    position = (trace.position - wave.position)[scans]
    return SegmentNumbers(
        kind="hold" if segment % 2 else "ramp",
        velocity_error_mean=float(velocity.mean()),
        velocity_error_std=float(velocity.std()),
        position_error_mean=float(position.mean()),
        position_error_std=float(position.std()),
        noise_reduction=float((wave.measured - wave.position)[scans].std() / position.std()),
    )


def _bled(wave: Waveform, threshold: float) -> Trace:
    return run(wave.measured, replace(TUNING, BleedEnable=True, BleedThresh=threshold, BleedFactor=BLEED_FACTOR))


def _bleed_row(wave: Waveform, trace: Trace, threshold: float) -> BleedNumbers:
    velocity = float(trace.velocity[both(0, 2)].mean())
    return BleedNumbers(
        threshold=threshold,
        overshoot=overshoot(wave, trace.position, 1),
        velocity_on_ramp=velocity,
        velocity_bias=velocity - SLOPE,
        hold_velocity_std=float(trace.velocity[both(1, 3)].std()),
        rmse_position=rmse_position(wave, trace),
        rmse_velocity=rmse_velocity(wave, trace),
    )


def _rate_row(dt: float) -> RateNumbers:
    """The gains that the function block settles at, whatever it measures; the scaled ones in closed form."""
    q_x, q_x_dot, r_x = RATE_TUNING
    scans = round(20.0 / dt)  # 20 s: more than twenty of the slowest time constants
    trace = run(np.zeros(scans), replace(TUNING, dt=dt * 1000.0, q_x=q_x, q_x_dot=q_x_dot, r_x=r_x))
    K0, K1 = float(trace.K0[-1]), float(trace.K1[-1])
    scale = dt / DT
    scaled = steady_gains(q_x * scale, q_x_dot * scale, r_x / scale, dt)
    return RateNumbers(
        dt=dt,
        K0=K0,
        K1=K1,
        bandwidth=K0 / dt,
        time_constant=slowest_time_constant(K0, K1, dt),
        scaled_bandwidth=scaled[0] / dt,
        scaled_time_constant=slowest_time_constant(*scaled, dt),
    )
