"""Is the tuning right? Statistics of normalised innovations over a window, one row for each axis: pure arithmetic.

Of an observer whose Q and R are right, the normalised innovations ν = y/√S are independent with mean 0 and variance 1
(Bar-Shalom, Li, Kirubarajan: Estimation with Applications to Tracking and Navigation, 5.4). Over the last N of them:

| letter | meaning | tag | expected |
|---|---|---|---|
| ε̄ = Σν²/N | mean of the normalised innovation squared | NISMean | 1; N·ε̄ is χ² with N degrees of freedom |
| ρ_j = Σν_k·ν_{k−j}/Σν² | autocorrelation at lag j | Autocorrelation (j = 1) | 0 ± 1/√N |
| max \\|ρ_j\\| | largest over lags 1 … n | AutocorrelationMax | below AutocorrelationLimit |
| share of \\|ν\\| > 2 | outside ±2√S | Outside | 0.0455 |
| λ_min(P) | smallest eigenvalue of P | MinEigenvalue | ≥ 0 |

The window is made of ten blocks. Sums grow within a block; with its last update it enters the window, the
oldest leaves, and the ten are added up anew, so that nothing drifts. A window therefore moves every N/10 updates.
"""

import math
import sys
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.diagnosis import Diagnosis

Numbers = NDArray[np.float64]
Flags = NDArray[np.bool_]

BLOCKS: Final = 10
EXPECTED_OUTSIDE: Final = math.erfc(math.sqrt(2.0))  # of a normal variable beyond two sigma: 0.0455

_ABSURD: Final = 1e150  # ν whose square would not be a number for long
_MOST: Final = sys.float_info.max
_NIS_ALARM: Final = 0.999  # of consistent windows lie inside; the published band is at 95 %
_WHITE_ALARM: Final = 2.6  # standard errors of the mean autocorrelation, 99 %
_LAG_ALARM: Final = 0.2  # mean autocorrelation that counts as lag: a fifth of the innovation could be predicted
_SHAPE_ALARM: Final = 0.999  # of independent innovations have autocorrelations that differ less among each other
_SHAPE_LEAST: Final = 0.05  # Σ(ρ_j − mean)² that any track may have, however long the window
_FALL_LEAST: Final = 0.14  # the same for the fall of ρ over the lags: two standard errors of 200 updates
_SIGN_SURE: Final = 1.2  # standard errors: two of ρ beyond it, one on either side, are no lag
_JOINT_ALARM: Final = -2.0 * math.log(0.01)  # χ² with two degrees of freedom, 99 %
_R_WRONG: Final = 1.6  # estimated R over assumed R beyond which R gets the blame rather than Q


class ConsistencyState:
    """Sums and blocks of n axes. `window` updates (a multiple of ten), autocorrelations at `lags` lags."""

    def __init__(self, n: int, window: int, lags: int) -> None:
        if window < BLOCKS or window % BLOCKS or lags < 1:
            raise ValueError(f"window {window}, lags {lags}: expected a multiple of {BLOCKS}, and at least one lag")
        self.window, self.lags = window, lags
        self.settling = window // 4  # updates after a start that do not count: P is still on its way
        self.skip = np.full(n, self.settling)
        self.recent: Numbers = np.zeros((lags, n))  # ν of the last updates, the newest first
        self.count = np.zeros(n, np.int64)  # updates in the block that grows
        self.sums: Numbers = np.zeros((2 + lags, n))  # Σν², how many outside, Σν_k·ν_{k−1} …
        self.blocks: Numbers = np.zeros((BLOCKS, 2 + lags, n))
        self.at = np.zeros(n, np.int64)  # the block to be overwritten next
        self.filled = np.zeros(n, np.int64)  # how many blocks hold something
        self.totals: Numbers = np.zeros((2 + lags, n))  # of the blocks
        self._nu: Numbers = np.zeros(n)
        self._products: Numbers = np.zeros((lags, n))
        self._shifted: Numbers = np.zeros((lags, n))

    def __len__(self) -> int:
        return len(self.count)

    @property
    def full(self) -> Flags:
        """Rows whose window is full."""
        full: Flags = self.filled == BLOCKS
        return full

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first update after a start."""
        self.skip[rows] = self.settling
        for counter in (self.count, self.at, self.filled):
            counter[rows] = 0
        for array in (self.recent, self.sums, self.blocks, self.totals):
            array[..., rows] = 0.0


@np.errstate(all="ignore")
def step(state: ConsistencyState, y: Numbers, S: Numbers, rows: Flags) -> Flags | None:
    """Take the innovations of the rows that were updated in this scan, arrays[n]; the other rows are untouched.

    A row with S ≤ 0, or without a finite y/√S, counts as not updated. Returns the rows whose window moved, None
    where there is none.
    """
    nu = state._nu
    np.sqrt(S, out=nu)
    np.divide(y, nu, out=nu)
    counted = rows & (np.abs(nu) < _ABSURD)  # also false for NaN
    if state.skip.any():
        settling = counted & (state.skip > 0)
        state.skip[settling] -= 1
        counted &= ~settling
    everyone = bool(counted.all())
    if not everyone:
        if not counted.any():
            return None
        np.copyto(nu, 0.0, where=~counted)

    np.multiply(state.recent, nu, out=state._products)
    state.sums[2:] += state._products
    state.sums[0] += nu * nu
    state.sums[1] += np.abs(nu) > 2.0
    state._shifted[0] = nu
    state._shifted[1:] = state.recent[:-1]
    if everyone:
        np.copyto(state.recent, state._shifted)
    else:
        np.copyto(state.recent, state._shifted, where=counted)

    state.count += counted
    ended: Flags = state.count >= state.window // BLOCKS
    if not ended.any():
        return None
    if ended.all() and (state.at == state.at[0]).all():
        _close_all(state, int(state.at[0]))
    else:
        _close(state, np.flatnonzero(ended))
    return ended


def _close_all(state: ConsistencyState, at: int) -> None:
    """The growing block of every row becomes the newest of the window; all of them lie in the same place."""
    np.copyto(state.blocks[at], state.sums)
    np.add.reduce(state.blocks, axis=0, out=state.totals)
    state.at.fill((at + 1) % BLOCKS)
    np.minimum(state.filled + 1, BLOCKS, out=state.filled)
    state.sums.fill(0.0)
    state.count.fill(0)


def _close(state: ConsistencyState, rows: NDArray[np.intp]) -> None:
    """The growing block of these rows becomes the newest of the window."""
    state.blocks[state.at[rows], :, rows] = state.sums[:, rows].T
    state.at[rows] = (state.at[rows] + 1) % BLOCKS
    state.filled[rows] = np.minimum(state.filled[rows] + 1, BLOCKS)
    state.totals[:, rows] = np.add.reduce(state.blocks[:, :, rows], axis=0)
    state.sums[:, rows] = 0.0
    state.count[rows] = 0


class Figures:
    """The statistics of n windows: `nis`, `outside`, `rho` [lags, n]; NaN where nothing is known yet."""

    def __init__(self, state: ConsistencyState) -> None:
        n = state.filled * (state.window // BLOCKS)
        energy = state.totals[0]
        with np.errstate(all="ignore"):
            self.nis: Numbers = np.where(n > 0, energy / n, np.nan)
            self.outside: Numbers = np.where(n > 0, state.totals[1] / n, np.nan)
            rho = np.where(energy > 0.0, state.totals[2:] / energy, 0.0)  # all innovations 0: no correlation
            self.rho: Numbers = np.where(n > 0, rho, np.nan)


def chi_square_mean(p: float, n: int) -> float:
    """Quantile p of a mean of n squared standard normal variables, χ²(n)/n, by Wilson and Hilferty.

    (1 − 2/(9n) + z·√(2/(9n)))³; within 0.003 of the true value for n ≥ 50 and p from 0.0005 to 0.9995.
    """
    spread = 2.0 / (9.0 * n)
    root = 1.0 - spread + NormalDist().inv_cdf(p) * math.sqrt(spread)
    return root * root * root


def nis_band(window: int, share: float = 0.95) -> tuple[float, float]:
    """Where the mean NIS of a consistent window lies with this probability, the same share left out on each side."""
    tail = (1.0 - share) / 2.0
    return chi_square_mean(tail, window), chi_square_mean(1.0 - tail, window)


def autocorrelation_limit(window: int, lags: int, share: float = 0.95) -> float:
    """What the largest |ρ| over the lags stays below with this probability, for independent innovations.

    Each ρ is normal with variance 1/N, nearly independent of the others.
    """
    each = share ** (1.0 / lags)
    return NormalDist().inv_cdf(0.5 + each / 2.0) / math.sqrt(window)


@np.errstate(all="ignore")
def diagnose(state: ConsistencyState, figures: Figures, K0: Numbers) -> NDArray[np.uint8]:
    """The Diagnosis of each row by its window; `K0` is the gain for the position, 0 where it is not known.

    Something is wrong when the mean NIS leaves its 99.9 % band, or the mean autocorrelation is below −2.6 standard
    errors (the estimate follows the noise) or above 0.2 (it lags). What is wrong tells an estimate of R from the
    innovations themselves (after Mehra, 1970): what is correlated between neighbours is no measurement noise, so
    R̂/R = ε̄·(1 − ρ₁/(1 − K0)). Beyond a factor of 1.6 R gets the blame, otherwise Q; neither where the innovations
    swing, since that averages out in ρ and no Q and no R makes it: then they are not random, and no more is said.
    """
    low, high = nis_band(state.window, _NIS_ALARM)
    mean = np.add.reduce(figures.rho, axis=0) / state.lags
    noise = _WHITE_ALARM / math.sqrt(state.window * state.lags)
    r = figures.nis * (1.0 - figures.rho[0] / (1.0 - K0))
    r_small, r_large = r > _R_WRONG, r < 1.0 / _R_WRONG

    not_random, swings = _not_random(state, figures)
    jitters, lagging = mean < -noise, mean > max(_LAG_ALARM, noise)
    conditions: list[Any] = [
        ~state.full,
        (figures.nis > high) & r_small,
        (figures.nis < low) & r_large,
        swings,
        figures.nis > high,
        figures.nis < low,
        jitters & r_small,
        jitters,
        lagging & r_large,
        lagging,
        not_random,
    ]
    codes = [
        Diagnosis.NOT_ENOUGH_DATA,
        Diagnosis.R_TOO_SMALL,
        Diagnosis.R_TOO_LARGE,
        Diagnosis.NOT_RANDOM,
        Diagnosis.Q_TOO_SMALL,
        Diagnosis.Q_TOO_LARGE,
        Diagnosis.R_TOO_SMALL,
        Diagnosis.Q_TOO_LARGE,
        Diagnosis.R_TOO_LARGE,
        Diagnosis.Q_TOO_SMALL,
        Diagnosis.NOT_RANDOM,
    ]
    found: NDArray[np.uint8] = np.select(conditions, [int(code) for code in codes], int(Diagnosis.CONSISTENT)).astype(
        np.uint8
    )
    return found


def _not_random(state: ConsistencyState, figures: Figures) -> tuple[Flags, Flags]:
    """Rows whose ρ_j differ among each other by more than chance, and those of them that surely fall from + to −.

    An estimate that lags makes all ρ_j much the same, and their mean finds it. One that swings makes them swing,
    and in their mean that is lost. Either their scatter is beyond its 99.9 %, or they fall over the lags, and that
    together with the mean NIS is beyond 99 %.
    """
    rho, window, lags = figures.rho, state.window, state.lags
    if lags == 1:
        nowhere: Flags = np.zeros(len(state), np.bool_)
        return nowhere, nowhere
    off = rho - np.add.reduce(rho, axis=0) / lags
    scatter = np.add.reduce(off * off, axis=0)
    most = chi_square_mean(_SHAPE_ALARM, lags - 1) * (lags - 1) / window

    weights = (lags + 1) / 2.0 - np.arange(1.0, lags + 1)
    weights /= math.sqrt(float(np.add.reduce(weights * weights)))
    fall = np.add.reduce(weights[:, np.newaxis] * rho, axis=0)  # variance 1/N
    spread = 2.0 / (9.0 * window)
    z = (np.cbrt(figures.nis) - (1.0 - spread)) / math.sqrt(spread)
    falls: Flags = (fall > max(1.96 / math.sqrt(window), _FALL_LEAST)) & (window * fall * fall + z * z > _JOINT_ALARM)

    sure = _SIGN_SURE / math.sqrt(window)
    swings: Flags = falls & (rho.max(axis=0) > sure) & (rho.min(axis=0) < -sure)
    return (scatter > max(most, _SHAPE_LEAST)) | falls, swings


@np.errstate(all="ignore")
def smallest_eigenvalue(P00: Numbers, P01: Numbers, P11: Numbers) -> Numbers:
    """λ_min of the symmetric 2×2 matrices [[P00, P01], [P01, P11]], arrays[n]; NaN where one of them is not finite.

    As det/λ_max where λ_max > 0, which keeps its digits where the entries differ by many powers of ten.
    """
    gap = 0.5 * P00 - 0.5 * P11
    root = np.sqrt(gap * gap + P01 * P01)
    largest = 0.5 * P00 + 0.5 * P11 + root
    smallest: Numbers = np.where(largest > 0.0, (P00 * P11 - P01 * P01) / largest, largest - 2.0 * root)
    if not np.isfinite(smallest).all():  # a product overflowed
        plain = 0.5 * P00 + 0.5 * P11 - np.hypot(gap, P01)
        smallest = np.where(np.isfinite(smallest), smallest, np.clip(plain, -_MOST, _MOST))
    return smallest
