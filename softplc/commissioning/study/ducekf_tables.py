"""The tables of the DUCEKF study."""

from collections.abc import Sequence

from softplc.commissioning.report import Table, number
from softplc.commissioning.study.ducekf_figures import NAMES
from softplc.commissioning.study.ducekf_numbers import DucekfNumbers
from softplc.commissioning.study.ducekf_timing import ROUTES_US

_STEPS = {"euler": "explicit Euler", "semi_implicit": "semi-implicit Euler", "rk4": "Runge–Kutta 4"}
_BANDS = {"above": "0 < x(1) ≤ ε₀", "below": "−ε₀ ≤ x(1) < 0"}
_JUDGED = {"carried": "state carried in, transition is the step", "same": "new sample, in the same iteration"}


def paths_text(paths: Sequence[tuple[int, int, tuple[int, ...]]]) -> str:
    """Runs of equal routes in one line."""
    return "; ".join(
        f"{first if first == last else f'{first}–{last}'} {{{', '.join(map(str, routes))}}} × {last - first + 1}"
        for first, last, routes in paths
    )


def paths(numbers: DucekfNumbers) -> Table:
    """Table A2 with two columns of times."""
    rows = [
        (
            str(index),
            f"{path.first}" if path.quantity == 1 else f"{path.first}–{path.last}",
            ", ".join(f"{route} ({ROUTES_US[route]:g})" for route in path.routes),
            str(path.quantity),
            f"{path.paper_us:.1f}",
            f"{path.here_us:.1f}",
        )
        for index, path in enumerate(numbers.timing.paths, 1)
    ]
    return Table(
        ("path", "k", "routes (the paper's µs)", "quantity", "paper, µs", "here, µs"),
        rows,
        "As Table A2. Routes 1 and 2: is the direction known; 3: transition; 4: predict and update; 5: hold; 6: "
        f"no hold. Here: median over the path's iterations, each of them the median of {len(numbers.timing.times)} "
        "runs. Paths 2 and 4 are the same routes.",
        words=3,
    )


def statistics(numbers: DucekfNumbers) -> Table:
    """A.3."""
    paper, here = numbers.timing.paper, numbers.timing.here
    rows = [
        ("mean, µs", "252.972", f"{paper.mean:.3f}", f"{here.mean:.3f}"),
        ("variance, µs²", "0.2736", f"{paper.variance:.4f}", f"{here.variance:.4f}"),
        ("standard deviation, µs", "0.5231", f"{paper.deviation:.4f}", f"{here.deviation:.4f}"),
    ]
    return Table(
        ("", "printed", "recomputed", "here"),
        rows,
        "As A.3, over all 350 iterations. The paper gives each path one constant time, so its spread is that "
        "between the paths alone; here each iteration has its own.",
    )


def lyapunov(numbers: DucekfNumbers) -> Table:
    """Figure 3 in numbers."""
    rows = [
        (
            str(one.k),
            number(one.ekf),
            f"{one.ekf / one.ekf_before:+.2f}",
            number(one.ducekf, 2),
            number(abs(one.ducekf) / one.ducekf_before, 2),
        )
        for one in numbers.lyapunov
    ]
    return Table(
        ("impact at k", "EKF ΔV", "of V", "DUCEKF ΔV, rounding", "of V"),
        rows,
        "V(eᵢ) − V(eᵢ₋₁) of (21) with the true error, κ = 1.5.",
    )


def consistency(numbers: DucekfNumbers) -> Table:
    """The bars in numbers."""
    rows = [
        (
            f"κ = {one.kappa:g}, {NAMES[one.covariance]}",
            f"{one.nees:.2f} ± {one.nees_error:.2f}",
            number(one.rmse_velocity),
        )
        for one in numbers.noise
    ]
    return Table(
        ("after the impact", "mean eᵀP⁻¹e", "velocity RMSE"),
        rows,
        "Q = 10⁻⁵·I and R = 10⁻⁴, true of the oscillator and told to the filter; 20 scans from the first impact "
        "on, the same noise in every row; ± is the standard error. The contact is judged by x(2) < 0, as in (12).",
    )


def readings(numbers: DucekfNumbers) -> Table:
    """What k = 315 says about how the paper computed."""
    rows = [
        (
            _STEPS[one.step],
            _BANDS[one.edge],
            _JUDGED[one.judged],
            ", ".join(str(k) for k in one.impacts),
            "✔" if one.impacts[0] == 315 else "",
        )
        for one in numbers.readings
    ]
    return Table(
        ("step", "activation set", "what is tested", "impacts up to k = 1000", "315"),
        rows,
        "Figure A1 with the conditions is an image, and the minus signs of section 2.2 are lost in the text. The "
        "first row is adopted: the paper names Euler, A.2 says “positive, in the activation set, and decreasing”, "
        "and xᵢ = μ(xᵢ₋₁) is a step of its own. Others also reach 315, and part from it only at the second "
        "impact.",
        words=4,
    )


def remarks(numbers: DucekfNumbers) -> Table:
    """Inconsistencies, each with what is done about it."""
    product = numbers.product
    rows = [
        (
            "Section 4.2, Table A1: main algorithm 248 µs on average. A.3: mean 252.972 µs.",
            "248 is near the mean of 243 and 252, the two routes unweighted. Both are quoted.",
        ),
        (
            "A.3: (243.2 − 252.972)² = 95.496.",
            "It is 95.492; the variance printed is right to its four digits either way.",
        ),
        (
            "A.2: Path 2 and Path 4 are told apart.",
            "They take the same routes; the impact separates them.",
        ),
        (
            "(18), (28): Pᵢ = ΩPᵢ₋₁.",
            "Entry by entry, Ω∘P, with minus off the diagonal. As a matrix product Ω is singular: P comes out with "
            f"P01 = {number(product.product_P01)} and P10 = {number(product.product_P10)}, and (29) fails by "
            f"{number(product.product_29)}.",
        ),
        (
            "Section 2.2: ε is half open with a lost sign; Table 1 prints ε for ε₀.",
            "(0, ε₀], as A.2 says; the other is an option.",
        ),
        (
            "(12): falling is x(2) < 0. A.2: falling is a position that decreases.",
            "Both give 315. Without any test of the direction, k = 2 would be an impact.",
        ),
        (
            "ε₀ = 0.02 against |x(2)|·ΔT = 0.015.",
            "Just enough. With a step of 20 ms one impact in three would jump over the set. On live axes the band is "
            "widened by |v|Δt and crossings are detected.",
        ),
        (
            "Theorem 1: Ω guarantees stability.",
            "At the transition, for V = eᵀPe, under Assumption 1 (simultaneous contact). It is a statement about "
            "V, not about the covariance of the error.",
        ),
        ("κ = 0 (no rebound) is not excluded.", "1/κ is then undefined: Ω is refused, saltation works."),
    ]
    return Table(("the paper", "found"), rows, words=2)
