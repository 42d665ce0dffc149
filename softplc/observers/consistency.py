"""The tags that tell whether an axis' tuning fits its motion and its noise; refreshed ten times a window."""

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.batch import consistency as batch
from softplc.kernel.diagnosis import Diagnosis
from softplc.kernel.result import Result
from softplc.observers.kernel import Flags, Kernel
from softplc.sample import Reason, StatusCode

if TYPE_CHECKING:
    from softplc.observers.axes import AxisSpec
    from softplc.observers.judgement import Judgement
    from softplc.observers.published import Published

INNOVATIONS: Final = (
    "NISMean",
    "NISLow",
    "NISHigh",
    "Autocorrelation",
    "AutocorrelationMax",
    "AutocorrelationLimit",
    "Outside",
)
COVARIANCE: Final = ("MinEigenvalue", "CovarianceValid")
LAMP: Final = "Consistency"
NEEDS: Final = ("Innovation", "S")
"""Estimates without which there is no consistency to be told."""

_WINDOWED: Final = ("NISMean", "Autocorrelation", "AutocorrelationMax", "Outside")
_ENTRIES: Final = ("P00", "P01", "P11")
_SAME: Final = 2  # equal samples in a row that still count: a value that stays longer is held and says nothing
_ROUNDING: Final = 8.0  # units in the last place of the trace by which rounding may make λ_min negative


def consistency_leaves(estimates: tuple[str, ...]) -> tuple[str, ...]:
    """The leaves for an observer with these estimates; none where it estimates no innovation and S."""
    if not set(NEEDS) <= set(estimates):
        return ()
    covariance = COVARIANCE if set(_ENTRIES) <= set(estimates) else ()
    return (*INNOVATIONS, *covariance, LAMP)


class Consistency:
    """Fills the consistency tags of n axes that share a window and a number of lags. All arrays[n]."""

    def __init__(self, spec: "AxisSpec", kernel: Kernel, tags: "Published", n: int, dtype: DTypeLike) -> None:
        if spec.consistency is None:
            raise ValueError(f"{spec.name} has no window to judge its consistency in")
        window, lags = spec.consistency
        self._kernel, self._tags = kernel, tags
        self._state = batch.ConsistencyState(n, window, lags)
        self._tolerance = _ROUNDING * float(np.finfo(dtype).eps)
        self._has_covariance = "MinEigenvalue" in tags
        self._windowed = tags.rows(*_WINDOWED)
        self._verdict = np.zeros(n, np.uint8)
        self._z = np.full(n, np.nan)
        self._same = np.zeros(n, np.int64)
        self._updated: Flags = np.zeros(n, np.bool_)
        self._status = np.full(n, StatusCode.BAD_WAITING_FOR_INITIAL_DATA, np.uint32)
        for leaf in _WINDOWED:
            tags.row(leaf)[:] = np.nan
        tags.row("NISLow")[:], tags.row("NISHigh")[:] = batch.nis_band(window)
        tags.row("AutocorrelationLimit")[:] = batch.autocorrelation_limit(window, lags)

    def clear(self, rows: Flags) -> None:
        """Begin a new window: the observer starts anew, or its tuning changed."""
        self._state.clear(rows)
        self._refresh(rows)

    def judge(self, samples: "Judgement", stepped: Flags, results: NDArray[np.uint8]) -> None:
        """Take what the kernel did in this scan; `stepped` are the rows whose state is from this scan."""
        state, tags = self._state, self._tags
        np.equal(results, Result.UPDATED, out=self._updated)
        np.logical_and(self._updated, stepped, out=self._updated)
        started = (results == Result.INITIALISED) & stepped
        if started.any():
            self.clear(started)
        self._count_repetitions(samples.z, stepped)
        self._updated &= self._same <= _SAME
        moved = batch.step(state, tags.row("Innovation"), tags.row("S"), self._updated)
        if moved is not None:
            self._refresh(moved)

        if self._has_covariance:
            smallest = batch.smallest_eigenvalue(*(tags.row(leaf) for leaf in _ENTRIES))
            allowed = self._tolerance * np.abs(tags.row("P00") + tags.row("P11"))
            tags.row("MinEigenvalue")[:] = smallest
            valid = smallest >= -allowed  # false for NaN
            tags.row("CovarianceValid")[:] = valid
            tags.row(LAMP)[:] = np.where(valid, self._verdict, int(Diagnosis.COVARIANCE_NOT_VALID))
        else:
            tags.row(LAMP)[:] = self._verdict
        self._tell(samples)

    def _count_repetitions(self, z: NDArray[np.float64], stepped: Flags) -> None:
        if stepped.all():
            self._same *= z == self._z
            self._same += 1
            np.copyto(self._z, z)
        else:
            np.copyto(self._same, np.where(z == self._z, self._same + 1, 1), where=stepped)
            np.copyto(self._z, z, where=stepped)

    def _refresh(self, moved: Flags) -> None:
        """Windows of these rows moved: figures and verdict anew, by the gain that they have now."""
        tags, figures = self._tags, batch.Figures(self._state)
        tags.row("NISMean")[:] = figures.nis
        tags.row("Outside")[:] = figures.outside
        tags.row("Autocorrelation")[:] = figures.rho[0]
        tags.row("AutocorrelationMax")[:] = np.abs(figures.rho).max(axis=0)
        gain = tags.row("K0") if "K0" in tags else np.zeros(len(self._state))
        verdict = batch.diagnose(self._state, figures, gain)
        bleeds = self._kernel.tuning.get("BleedEnable")
        if bleeds is not None and bleeds.any():
            wrong = (verdict != Diagnosis.NOT_ENOUGH_DATA) & (verdict != Diagnosis.CONSISTENT)
            verdict[wrong & bleeds.astype(np.bool_)] = Diagnosis.BLEED
        np.copyto(self._verdict, verdict, where=moved)
        self._settle_status()

    def _settle_status(self) -> None:
        """What the windowed tags are while the estimates are Good."""
        full = np.uint32(StatusCode.GOOD), np.uint32(StatusCode.UNCERTAIN_INITIAL_VALUE)
        self._status = np.where(self._state.full, *full)
        self._status[self._state.filled == 0] = StatusCode.BAD_WAITING_FOR_INITIAL_DATA

    def _tell(self, samples: "Judgement") -> None:
        """Statuses: as the window is, but Uncertain as well where the estimates are not Good."""
        current = samples.status < np.uint32(StatusCode.UNCERTAIN)
        if current.all():
            self._tags.tell(self._windowed, self._status)
            return
        uncertain = samples.reason == Reason.INPUT_UNCERTAIN
        old = np.where(uncertain, samples.status, np.uint32(StatusCode.UNCERTAIN_LAST_USABLE_VALUE))
        good = self._status < np.uint32(StatusCode.UNCERTAIN)
        self._tags.tell(self._windowed, np.where(current | ~good, self._status, old))
