"""`softplc study ducekf`: the DUCEKF paper's case study as a report."""

from dataclasses import dataclass

from softplc import __version__
from softplc.commissioning.figures import drawing
from softplc.commissioning.report import Claim, Picture, Report, Section, Table, number
from softplc.commissioning.study import ducekf_figures as figures
from softplc.commissioning.study import ducekf_screens as screens
from softplc.commissioning.study import ducekf_tables as tables
from softplc.commissioning.study.ducekf_noise import KAPPAS
from softplc.commissioning.study.ducekf_numbers import CONVERGED, KAPPA, DucekfNumbers, experiment, velocity_error
from softplc.commissioning.study.ducekf_timing import ITERATIONS, PROCESSES_US, Clock
from softplc.commissioning.study.study import Study

_SHOWN = 1050  # iterations in the figures: three impacts
_PATHS = [(1, 1, (1, 4, 6)), (2, 314, (2, 4, 6)), (315, 315, (2, 3)), (316, 350, (2, 4, 6))]  # Table A2


@dataclass(frozen=True, slots=True)
class _Screen:
    """The display of Figure 7 and how long it took to draw, in µs."""

    picture: Picture
    us: float


def study(clock: Clock, seed: int = 0) -> Study:
    """Run and write it down; `clock` gives nanoseconds. Only what is timed differs from run to run.

    Raises SoftplcError without matplotlib.
    """
    with drawing():
        numbers = experiment(seed, clock)
        shown = numbers.scans[:_SHOWN]
        screens.hmi(shown)  # the first picture also loads fonts
        start = clock()
        picture = screens.hmi(shown)
        screen = _Screen(picture, (clock() - start) / 1000.0)
        report = _report(numbers, screen)
    data = numbers.to_json()
    data["timing"]["processes_us"]["picture"] = screen.us
    return Study("ducekf", report, {"seed": seed, **data})


def _report(numbers: DucekfNumbers, screen: _Screen) -> Report:
    here, paper = numbers.timing.here, numbers.timing.paper
    as_table_a2 = sum(
        path.quantity for path in numbers.timing.paths if (path.first, path.last, path.routes) in _PATHS
    )
    return Report(
        title="The discrete unilateral constrained extended Kalman filter",
        subtitle="L. Herrera, R. Méndez-Ramírez, “Discrete Unilateral Constrained Extended Kalman Filter in an "
        "Embedded System”, Sensors 25(15), 4636 (2025), doi 10.3390/s25154636: its case study, run anew.",
        headline=[
            (f"k = {numbers.impacts[0]}", "first impact, as in the paper"),
            (f"{as_table_a2} of {ITERATIONS}", "iterations take the paths of Table A2"),
            (f"{number(numbers.lyapunov[0].ekf)} / 0", "ΔV at the first impact, κ = 1.5: EKF / DUCEKF"),
            (f"{numbers.converged} scans", f"until the velocity is within {CONVERGED:g}"),
            (f"{here.mean:.1f} µs", f"mean time of steps 9–19 here; on the dsPIC {paper.mean:.3f} µs"),
        ],
        claims=_claims(numbers),
        sections=[
            _simulation(numbers),
            _stability(numbers),
            _execution(numbers, screen),
            _hold(numbers),
            _covariance(numbers),
            Section("Where the paper leaves a choice, or errs", [tables.readings(numbers), tables.remarks(numbers)]),
        ],
        origin=f"softplc {__version__}: `softplc study ducekf --seed {numbers.seed}`. Times are this machine's and "
        "differ from run to run; everything else is the same each time. The seed is that of the noise in "
        "the covariance section.",
    )


def _claims(numbers: DucekfNumbers) -> list[Claim]:
    paths = [(path.first, path.last, path.routes) for path in numbers.timing.paths]
    paper, first = numbers.timing.paper, numbers.impacts[0]
    before, impact = numbers.scans[first - 2], numbers.scans[first - 1]
    quiet = [abs(one.ducekf) / one.ducekf_before for one in numbers.lyapunov]
    nees = {(one.kappa, one.covariance): one.nees for one in numbers.noise}
    growth = [one.ekf / one.ekf_before for one in numbers.lyapunov]
    return [
        Claim(
            "350 iterations take the paths of Table A2",
            tables.paths_text(_PATHS),
            tables.paths_text(paths),
            paths == _PATHS,
        ),
        Claim(
            "the impact is at k = 315, and no other within 350",
            "315",
            ", ".join(str(k) for k in numbers.impacts) + f" within {len(numbers.scans)}",
            [k for k in numbers.impacts if k <= ITERATIONS] == [315],
        ),
        Claim(
            "estimates converge despite other initial conditions, Figures 1 and 2",
            "x̂ → x",
            f"|x(2) − x̂(2)| < {CONVERGED:g} from k = {numbers.converged} on, "
            f"{number(abs(velocity_error(numbers.scans[313])), 2)} at k = 314",
            numbers.converged < 100,
        ),
        Claim(
            "at an impact the position stays and the velocity turns, (15) and (17)",
            "x(2) → −κ·x(2), κ = 0.5",
            f"x = ({impact.x[0]:.8f}, {impact.x[1]:.8f})",
            impact.x == (before.x[0], -KAPPA * before.x[1])
            and impact.x_hat == (before.x_hat[0], -KAPPA * before.x_hat[1]),
        ),
        Claim(
            "with Ω the Lyapunov function does not change at an impact, Figure 3",
            "ΔV = 0, κ = 1.5",
            f"|ΔV| = {', '.join(number(part, 1) for part in quiet)} of V: the last bits of x and x̂",
            all(part <= one.rounding for part, one in zip(quiet, numbers.lyapunov, strict=True)),
        ),
        Claim(
            "without Ω it grows",
            "ΔV > 0, κ = 1.5",
            ", ".join(number(one.ekf) for one in numbers.lyapunov),
            all(part > 0.0 for part in growth),
        ),
        Claim(
            "(29) holds: ÃᵀP⁺Ã = P",
            "0",
            f"{number(numbers.product.elementwise_29, 2)} with Ω entry by entry; "
            f"{number(numbers.product.product_29)} as a matrix product",
            numbers.product.elementwise_29 < 1e-15,
        ),
        Claim(
            "an estimate that is early waits for the oscillator, Route 5",
            "joint transition",
            f"holds k = {numbers.held[0]}…{numbers.held[-1]}, transition at {first}",
            numbers.held == list(range(numbers.held[0], first)) and numbers.hold[first - 1].impact,
        ),
        Claim(
            "ours: with noise P⁺ = ÃPÃᵀ stays consistent through an impact, Ω∘P does not",
            "eᵀP⁻¹e nearer to 2 with ÃPÃᵀ",
            "; ".join(
                f"κ = {kappa:g}: {nees[kappa, 'saltation']:.2f}, Ω∘P {nees[kappa, 'omega']:.2f}" for kappa in KAPPAS
            ),
            all(abs(nees[kappa, "saltation"] - 2.0) < abs(nees[kappa, "omega"] - 2.0) for kappa in KAPPAS),
        ),
        Claim(
            "the statistics of A.3 follow from the paper's route times",
            "mean 252.972 µs, variance 0.2736 µs², σ 0.5231 µs",
            f"{paper.mean:.3f}, {paper.variance:.4f}, {paper.deviation:.4f}",
            (round(paper.mean, 3), round(paper.variance, 4), round(paper.deviation, 4)) == (252.972, 0.2736, 0.5231),
        ),
    ]


def _simulation(numbers: DucekfNumbers) -> Section:
    shown = numbers.scans[:_SHOWN]
    return Section(
        "Simulation",
        [
            "A Van der Pol oscillator on one side of a wall, in explicit Euler steps of 10 ms, with the "
            "parameters of Table 1: α = μ = 1, ρ = 1.5, κ = 0.5, Q = 0.001·I, R = 10⁻⁴, ε₀ = 0.02, P₀ = 0.2·I. "
            "Only the position is measured. When the oscillator touches the wall, both it and the filter make the "
            "transition in the place of that iteration's step.",
            figures.time_series(numbers),
            figures.phase_portrait(numbers),
            screens.oscilloscope(shown),
        ],
    )


def _stability(numbers: DucekfNumbers) -> Section:
    soft = numbers.lyapunov_soft[0]
    return Section(
        "Stability at the impact",
        [
            "The transition is integrated into both filters; the EKF leaves P alone, the DUCEKF takes Ω∘P. The "
            "comparison needs κ = 1.5: at κ = 0.5 an impact takes energy out, and the EKF's ΔV is negative as "
            f"well ({number(soft.ekf)} at the first impact).",
            figures.lyapunov(numbers),
            tables.lyapunov(numbers),
        ],
    )


def _execution(numbers: DucekfNumbers, screen: _Screen) -> Section:
    main, picture, output = PROCESSES_US
    here = numbers.timing
    return Section(
        "Execution time, path by path",
        [
            "Tables A1 and A2 and the statistics of A.3 once more, with this machine's own measured numbers "
            "beside those of the paper's dsPIC33EP. The algorithm here is the scalar reference in plain Python.",
            Table(
                ("process", "steps", "paper, µs", "here, µs"),
                [
                    ("main algorithm, DHVPO and DUCEKF", "9–19", number(main), f"{here.here.mean:.1f}"),
                    ("picture of the phase portraits", "20–22", number(picture, 5), number(screen.us, 4)),
                    ("four states to the converter", "23", number(output), f"{here.output_us:.1f}"),
                ],
                "As Table A1. The paper draws one line of a picture of 320 × 240 in each iteration, here the "
                "whole of Figure 7 is drawn; here the words of 24 bits are packed and not sent.",
                words=2,
            ),
            tables.paths(numbers),
            tables.statistics(numbers),
            figures.timing(numbers),
            screen.picture,
        ],
    )


def _hold(numbers: DucekfNumbers) -> Section:
    return Section(
        "Synchronisation: an estimate that is early",
        [
            "The oscillator's contact triggers both transitions, wherever the estimate is. An estimate that "
            "arrives first is held at the surface; P is held with it, about which the paper is silent.",
            figures.hold(numbers),
        ],
    )


def _covariance(numbers: DucekfNumbers) -> Section:
    return Section(
        "The covariance after an impact",
        [
            "Ω is chosen so that V = eᵀPe does not change. The covariance that belongs to e⁺ = Ãe, however, is P⁺ "
            "= ÃPÃᵀ (the saltation matrix), and Ω∘P is its opposite: for κ < 1 it grows where the error shrinks. "
            "Without noise, as in the paper, that is without consequence. With noise the filter is too cautious "
            "after impacts for κ < 1, and too confident for κ > 1. The study keeps Ω; for live axes `saltation` "
            "is recommended.",
            figures.covariance(numbers),
            tables.consistency(numbers),
        ],
    )
