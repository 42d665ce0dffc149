"""`softplc study aoi`: the AOI paper's experiment as a report."""

from collections.abc import Sequence

from softplc import __version__
from softplc.commissioning.figures import drawing
from softplc.commissioning.report import Claim, Report, Section, Table, number
from softplc.commissioning.study import aoi_figures as figures
from softplc.commissioning.study import method_report
from softplc.commissioning.study.aoi_numbers import BLEED_FACTOR, AoiNumbers, experiment, hold_noise_reduction
from softplc.commissioning.study.aoi_runs import TUNING, noise_left
from softplc.commissioning.study.method_numbers import MethodNumbers, compare
from softplc.commissioning.study.study import Study
from softplc.commissioning.study.waveform import DT, SLOPE


def study(seed: int = 0) -> Study:
    """Run and write it down; the same seed gives the same bytes. Raises SoftplcError without matplotlib."""
    with drawing():
        numbers = experiment(seed)
        methods = compare(seed)
        report = _report(numbers, methods)
    return Study("aoi", report, {"seed": seed, **numbers.to_json(), "methods": method_report.to_json(methods)})


def _report(numbers: AoiNumbers, methods: Sequence[MethodNumbers]) -> Report:
    noise = hold_noise_reduction(numbers.wave, numbers.trace)
    ramp = numbers.segments[0]
    return Report(
        title="The two-state Kalman observer on ramp–hold–ramp–hold",
        subtitle="T. Turner, “Discrete-Time Implementation of a Two-State Kalman Observer in a Scan-Based Real-Time "
        "Control Environment” (2026): the experiment of equation (23), run anew by the add-on instruction's own "
        "arithmetic.",
        headline=[
            (f"{noise:.1f} ×", "less noise on the position, at rest"),
            (f"{ramp.velocity_error_mean:+.3f} u/s".replace("-", "−"), "mean velocity error on the first ramp"),
            (f"{ramp.velocity_error_std:.2f} u/s", "its standard deviation"),
            (f"{numbers.overshoots[0]:.2f} u", "overshoot at the first stop"),
            (
                f"{numbers.steady[0]:.3f}, {numbers.steady[1]:.3f}",
                f"gains K0, K1 (1/s) from scan {max(numbers.settled_scans)} on",
            ),
        ],
        claims=[*_claims(numbers), method_report.claim(methods)],
        sections=[
            _experiment(numbers),
            _gains(numbers),
            _bleed(numbers),
            _scan_rate(numbers),
            _precision(numbers),
            method_report.section(methods, numbers.wave),
        ],
        origin=f"softplc {__version__}: `softplc study aoi --seed {numbers.seed}`. The same seed gives this file "
        "again, byte for byte, with the same versions of softplc, numpy and matplotlib.",
    )


def _claims(numbers: AoiNumbers) -> list[Claim]:
    """Bounds hold for any seed: they are several standard errors of what they bound."""
    trace, (K0, K1) = numbers.trace, numbers.steady
    noise, theory = hold_noise_reduction(numbers.wave, trace), 1.0 / noise_left(K0, K1, DT)[0]
    error = numbers.bleed[0].velocity_bias
    off, on = numbers.bleed[:2]
    drift = max(abs(trace.K0[-1] - K0) / K0, abs(trace.K1[-1] - K1) / K1)
    sane = bool(
        (trace.S > 0.0).all()
        and (trace.P00 >= 0.0).all()
        and (trace.P11 >= 0.0).all()
        and (trace.K0 >= 0.0).all()
        and (trace.K0 <= 1.0).all()
    )
    position, velocity = numbers.single_difference()
    return [
        Claim(
            "noise is attenuated in steady-state holds",
            f"{theory:.2f} × less, by the settled gains",
            f"{noise:.2f} × less",
            0.65 * theory < noise < 1.35 * theory,
        ),
        Claim(
            "slopes are tracked accurately",
            f"{SLOPE:g} u/s, no mean error",
            f"{SLOPE + error:.3f} u/s over both ramps",
            abs(error) < 0.015 * SLOPE,
        ),
        Claim(
            "the transient at a discontinuity is predictable",
            f"{numbers.quiet_overshoot:.2f} u overshoot without noise",
            " and ".join(f"{value:.2f}" for value in numbers.overshoots) + " u with noise",
            all(abs(value - numbers.quiet_overshoot) < 2.0 for value in numbers.overshoots),
        ),
        Claim(
            "the gains settle where theory says",
            f"K0 {K0:.10f}, K1 {K1:.10f}",
            f"K0 {trace.K0[-1]:.10f}, K1 {trace.K1[-1]:.10f}",
            drift < 1e-9,
        ),
        Claim(
            "velocity is corrected though it is not measured",
            "K1 > 0 after one prediction",
            f"K1 = {trace.K1[0]:.3f} in the first scan",
            bool(trace.K1[0] > 0.0),
        ),
        Claim(
            "S is never ≤ 0, P00 and P11 never negative, K0 within 0…1",
            "in every scan",
            f"S ≥ {number(float(trace.S.min()))}, P00 ≥ {number(float(trace.P00.min()))}, "
            f"P11 ≥ {number(float(trace.P11.min()))}, K0 ≤ {number(float(trace.K0.max()))}",
            sane,
        ),
        Claim(
            "bleed lessens the overshoot at a stop",
            f"less than {off.overshoot:.2f} u",
            f"{on.overshoot:.2f} u; but a true {SLOPE:g} u/s reads {on.velocity_on_ramp:.1f}",
            on.overshoot < off.overshoot,
        ),
        Claim(
            "single precision is enough",
            "differences far below the noise",
            f"{number(position, 2)} u, {number(velocity, 2)} u/s",
            position < 1e-3 and velocity < 1e-2,
        ),
    ]


def _experiment(numbers: AoiNumbers) -> Section:
    spread = noise_left(*numbers.steady, DT)
    rows = [
        (
            f"{index}. {segment.kind}",
            f"{segment.position_error_mean:+.3f}",
            f"{segment.position_error_std:.3f}",
            f"{segment.noise_reduction:.2f}",
            f"{segment.velocity_error_mean:+.4f}",
            f"{segment.velocity_error_std:.3f}",
        )
        for index, segment in enumerate(numbers.segments, 1)
    ]
    theory = ("theory, settled gains", "0", f"{spread[0] * TUNING.r_x**0.5:.3f}", f"{1.0 / spread[0]:.2f}", "0")
    return Section(
        "The experiment",
        [
            f"A position that moves at {SLOPE:g} u/s for 15 s and rests for 15 s, twice, sampled every 50 ms, with "
            "noise evenly spread over ±2 u on each sample. The paper gives the time step and the noise; slope, "
            f"durations and tuning are ours: q_x = {TUNING.q_x:g}, q_x_dot = {TUNING.q_x_dot:g}, r_x = 4/3, the "
            "variance of that noise.",
            figures.trend(numbers),
            figures.velocity(numbers),
            Table(
                ("segment", "position error, mean", "std, u", "noise ÷", "velocity error, mean", "std, u/s"),
                [
                    *(tuple(_minus(cell) for cell in row) for row in rows),
                    (*theory, f"{spread[1] * TUNING.r_x**0.5:.3f}"),
                ],
                "Second half of each segment, when the transient is over. Errors are estimate − truth; noise ÷ is "
                "the standard deviation of the measured by that of the estimated position.",
            ),
        ],
    )


def _gains(numbers: AoiNumbers) -> Section:
    return Section(
        "Gains",
        [
            "At a constant time step the covariance, and with it the gains, converge whatever is measured. In "
            "closed form, with λ = Δt·√(q_x_dot/r_x) and μ = q_x/r_x: w = (λ + √(λ² + 16 + 4μ))/2, s = (w − √(λw "
            "+ μ))/2, K0 = 1 − s², K1 = √(q_x_dot/r_x)·s.",
            figures.gains(numbers),
        ],
    )


def _bleed(numbers: AoiNumbers) -> Section:
    rows = [
        (
            "off" if row.threshold == 0.0 else f"{row.threshold:g} u",
            f"{row.overshoot:.2f}",
            f"{row.velocity_on_ramp:.2f}",
            _minus(f"{row.velocity_bias:+.2f}"),
            f"{row.hold_velocity_std:.2f}",
            f"{row.rmse_position:.3f}",
            f"{row.rmse_velocity:.2f}",
        )
        for row in numbers.bleed
    ]
    return Section(
        "Bleed, and what it costs",
        [
            "The paper damps the velocity when the innovation is small, (22). Its code tests the deviation that "
            "is left after the correction, (1 − K0) times the innovation. Either is small wherever the observer "
            "tracks well, so bleed also acts on ramps, and pulls their velocity towards zero.",
            figures.bleed(numbers),
            Table(
                (
                    "threshold",
                    "overshoot, u",
                    "reads on a 10 u/s ramp",
                    "bias, u/s",
                    "std at rest, u/s",
                    "RMSE position",
                    "RMSE velocity",
                ),
                rows,
                f"Factor {BLEED_FACTOR:g} in each row.",
            ),
        ],
    )


def _scan_rate(numbers: AoiNumbers) -> Section:
    rows = [
        (
            f"{row.dt * 1000.0:g} ms",
            f"{row.K0:.4f}",
            f"{row.K1:.4f}",
            number(row.bandwidth, 2),
            f"{row.time_constant:.2f}",
            number(row.scaled_bandwidth, 2),
            f"{row.scaled_time_constant:.3f}",
        )
        for row in numbers.rates
    ]
    return Section(
        "The same numbers at another scan rate",
        [
            "Process noise is added per scan, not per second, and r_x is per sample. So the same tuning is "
            "another filter at another rate; the paper calls this mild. Scaling q with Δt alone does not cure it, "
            "since a noise per sample also sets the bandwidth: r has to go with 1/Δt.",
            figures.scan_rate(numbers),
            Table(
                ("Δt", "K0", "K1, 1/s", "K0/Δt, 1/s", "slowest, s", "scaled: K0/Δt", "scaled: slowest, s"),
                rows,
                "q_x = 0.001, q_x_dot = 0.1, r_x = 4/3; gains as the function block settles. Scaled: q·Δt/50 ms and "
                "r·50 ms/Δt. Slowest is the time constant of the slower pole.",
            ),
        ],
    )


def _precision(numbers: AoiNumbers) -> Section:
    return Section(
        "Single precision",
        [
            "A Logix REAL has 24 bits. Both columns of numbers come from the same text, once with every operation "
            "rounded to single and once in double precision.",
            figures.precision(numbers),
        ],
    )


def _minus(text: str) -> str:
    return text.replace("-", "−")
