"""The AOI's options on arrays: the operations of `kernel.reference.aoi_options` in the same order, bit-equal.

Each option is computed for all rows when any row has it, and then committed to those rows. What is rare, a start
anew in the midst of a scan, is a second pass over the rows concerned.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.batch.aoi import AoiBatchState, AoiTuning, Flags, Numbers, _initialise, _propagate, _Scratch
from softplc.kernel.reference.aoi_options import AoiOptions
from softplc.kernel.result import Result


class AoiBatchOptions:
    """The options of n function blocks, one entry of `options` for each, in the precision of the state."""

    def __init__(self, dtype: DTypeLike, options: Sequence[AoiOptions]) -> None:
        n = len(options)

        def numbers(values: Any) -> Numbers:
            with np.errstate(all="ignore"):
                return np.array(list(values), np.dtype(dtype))

        def flags(values: Any) -> Flags:
            return np.array(list(values), np.bool_)

        self.joseph = flags(one.joseph for one in options)
        self.min_r = numbers(one.min_r for one in options)
        self.K_limits = tuple(
            numbers(getattr(one, name)[side] for one in options)
            for name in ("K0_limits", "K1_limits")
            for side in (0, 1)
        )
        self.q_exponents = tuple(np.array([one.q_exponents[i] for one in options], np.intp) for i in (0, 1))
        self.white_accel = flags(one.white_accel for one in options)
        self.r_density = flags(one.r_density for one in options)
        self.bleed_on_innovation = flags(one.bleed_on_innovation for one in options)
        self.bleed_gated = flags(one.bleed_velocity is not None for one in options)
        self.bleed_velocity = numbers(one.bleed_velocity or 0.0 for one in options)
        self.gated = flags(one.gate is not None for one in options)
        self.gate = numbers(one.gate or 0.0 for one in options)
        self.gate_most = np.array([one.gate_most for one in options], np.int64)
        self.reinitialise = flags(one.reinitialise for one in options)
        self.referenced = flags(one.reference is not None for one in options)
        self.first_sample = flags(one.reference == "first_sample" for one in options)
        self.fixed = self.referenced & ~self.first_sample
        self.reference = np.array(
            [one.reference if fixed else 0.0 for one, fixed in zip(options, self.fixed, strict=True)]
        )

        self._by_power = bool(any(exponents.any() for exponents in self.q_exponents))
        self._any_limit = any(bool(np.isfinite(limit).any()) for limit in self.K_limits)
        self._any_joseph, self._any_gate = bool(self.joseph.any()), bool(self.gated.any())
        self._any_white, self._any_density = bool(self.white_accel.any()), bool(self.r_density.any())
        self._any_floor, self._any_reference = bool((self.min_r > -np.inf).any()), bool(self.referenced.any())
        self._may_restart = self._any_gate or bool(self.reinitialise.any())
        self._a, self._b = numbers([0.0] * n), numbers([0.0] * n)
        self._R = numbers([0.0] * n)

    @np.errstate(all="ignore")
    def step(
        self,
        state: AoiBatchState,
        tuning: AoiTuning,
        *,
        EnableIn: Flags,
        x: NDArray[Any],
        dt: NDArray[Any],
        rows: Flags,
    ) -> NDArray[np.uint8]:
        """One scan as `batch.aoi.step` does it, with the options; `state.y` is relative to `state.offset`."""
        new = state._scratch
        np.logical_and(rows, EnableIn, out=new.run)
        started = new.run & ~state.init
        self._take_x(state, new, x, started, rows)
        new.dt_s[:] = dt
        np.less_equal(new.dt_s, 0.0, out=new.flag)
        np.divide(new.dt_s, 1000.0, out=new.dt_s)
        np.copyto(new.dt_s, 0.0, where=new.flag)
        np.greater(new.dt_s, 0.0, out=new.go)
        np.logical_and(new.go, new.run, out=new.go)
        if started.any():
            _initialise(state, np.flatnonzero(started), new.x)
            state.in_a_row[started] = 0

        _propagate(state, new)
        self.add_noise(state, new, tuning)
        np.greater(new.S, 0.0, out=new.ok)
        beyond, restart = self._judge(state, new, started)
        self._correct(state, new, tuning, beyond)
        if restart is None:
            return self._commit(state, new, rows, started, beyond)

        result = self._commit(state, new, rows & ~restart, started, beyond).copy()
        state.init[restart] = False
        again = self.step(state, tuning, EnableIn=EnableIn, x=x, dt=dt, rows=restart)
        np.copyto(again, result, where=~restart)
        return again

    def _take_x(self, state: AoiBatchState, new: _Scratch, x: NDArray[Any], started: Flags, rows: Flags) -> None:
        """The measurement relative to its reference, in float64 until here."""
        if not self._any_reference:
            new.x[:] = x
            return
        np.copyto(state.offset, self.reference, where=self.fixed & rows)
        np.copyto(state.offset, x, where=self.first_sample & started)
        new.x[:] = x - state.offset

    def add_noise(self, state: AoiBatchState, new: _Scratch, tuning: AoiTuning) -> None:
        """Q, R, the innovation and its variance, (11), (12) and (17)."""
        x_cov0, x_cov1, x_cov2, x_cov3 = new.x_cov
        q_x, q_x_dot, dt_s = tuning.q_x, tuning.q_x_dot, new.dt_s
        if self._any_white:
            white, once = self.white_accel, q_x_dot * dt_s
            twice = once * dt_s
            np.add(x_cov1, twice / 2.0, out=x_cov1, where=white)
            np.add(x_cov2, twice / 2.0, out=x_cov2, where=white)
            q_x = np.where(white, q_x * dt_s + (twice * dt_s) / 3.0, self._scaled(q_x, dt_s, 0))
            q_x_dot = np.where(white, once, self._scaled(q_x_dot, dt_s, 1))
        elif self._by_power:
            q_x, q_x_dot = self._scaled(q_x, dt_s, 0), self._scaled(q_x_dot, dt_s, 1)
        np.add(x_cov0, q_x, out=x_cov0)
        np.add(state.P3, q_x_dot, out=x_cov3)

        np.copyto(self._R, tuning.r_x)
        if self._any_density:
            np.divide(tuning.r_x, dt_s, out=self._R, where=self.r_density)
        if self._any_floor:
            np.copyto(self._R, self.min_r, where=self.min_r > self._R)
        np.subtract(new.x, new.x_pred, out=new.y_res)
        np.add(x_cov0, self._R, out=new.S)

    def _scaled(self, q: Numbers, dt_s: Numbers, entry: int) -> Numbers:
        """q·Δt^exponent, the power as products; the factor is exactly 1 for exponent 0."""
        exponents, power, factor = self.q_exponents[entry], dt_s, np.ones_like(dt_s)
        for exponent in (1, 2, 3):
            np.copyto(factor, power, where=exponents == exponent)
            power = power * dt_s
        scaled: Numbers = q * factor
        return scaled

    def _judge(self, state: AoiBatchState, new: _Scratch, started: Flags) -> tuple[Flags | None, Flags | None]:
        """Rows whose innovation lies beyond the gate, and rows to start anew; None where there are none.

        Neither is corrected: `new.ok` is cleared for them.
        """
        if not self._may_restart:
            return None, None
        beyond = restart = None
        if self._any_gate:
            within = np.abs(new.y_res) <= self.gate * np.sqrt(new.S)
            beyond = self.gated & ~within & new.ok & new.go
            restart = beyond & (state.in_a_row >= self.gate_most)
        stuck = self.reinitialise & new.go & ~new.ok
        restart = stuck if restart is None else restart | stuck
        restart &= ~started
        if beyond is not None:
            beyond &= ~restart
            new.ok &= ~beyond
            state.in_a_row[new.go & new.ok] = 0
            state.in_a_row[beyond] += 1
            state.rejected[beyond] += 1
        if not restart.any():
            restart = None
        return (beyond if beyond is not None and beyond.any() else None), restart

    def _correct(self, state: AoiBatchState, new: _Scratch, tuning: AoiTuning, beyond: Flags | None) -> None:
        """Equations (16) to (22), into the scratch buffers."""
        a, b = self._a, self._b
        x_cov0, x_cov1, x_cov2, x_cov3 = new.x_cov

        np.divide(x_cov0, new.S, out=new.K0)
        np.divide(x_cov2, new.S, out=new.K1)
        if self._any_limit:
            for K, low, high in ((new.K0, *self.K_limits[:2]), (new.K1, *self.K_limits[2:])):
                np.copyto(K, low, where=low > K)
                np.copyto(K, high, where=high < K)

        np.multiply(new.K0, new.y_res, out=a)
        np.add(new.x_pred, a, out=new.x_pred, where=new.ok)
        np.multiply(new.K1, new.y_res, out=a)
        np.add(state.x_dot_pred, a, out=new.x_dot_pred)
        if tuning.BleedEnable.any():
            self._bleed(new, tuning)

        np.subtract(1.0, new.K0, out=a)
        np.multiply(a, x_cov0, out=new.P0)
        np.multiply(a, x_cov1, out=new.P1)
        np.multiply(new.K1, x_cov1, out=b)
        np.subtract(x_cov3, b, out=new.P3)
        if self._any_joseph:
            rest1 = x_cov1 - new.K1 * x_cov0
            np.copyto(new.P0, a * new.P0 + new.K0 * (new.K0 * self._R), where=self.joseph)
            np.copyto(new.P1, a * rest1 + new.K0 * (new.K1 * self._R), where=self.joseph)
            np.copyto(new.P3, (new.P3 - new.K1 * rest1) + new.K1 * (new.K1 * self._R), where=self.joseph)
        np.copyto(new.P2, new.P1)

        if beyond is not None:  # the prediction is all there is
            np.copyto(new.x_dot_pred, state.x_dot_pred, where=beyond)
            for P, x_cov in zip((new.P0, new.P1, new.P2, new.P3), new.x_cov, strict=True):
                np.copyto(P, x_cov, where=beyond)
            np.copyto(new.K0, 0.0, where=beyond)
            np.copyto(new.K1, 0.0, where=beyond)

    def _bleed(self, new: _Scratch, tuning: AoiTuning) -> None:
        """Equation (22)."""
        deviation = np.where(self.bleed_on_innovation, new.y_res, new.x - new.x_pred)
        small = tuning.BleedEnable & (np.abs(deviation) < tuning.BleedThresh)
        slow = ~self.bleed_gated | (np.abs(new.x_dot_pred) < self.bleed_velocity)
        np.multiply(new.x_dot_pred, tuning.BleedFactor, out=new.x_dot_pred, where=small & slow)

    def _commit(
        self, state: AoiBatchState, new: _Scratch, rows: Flags, started: Flags, beyond: Flags | None
    ) -> NDArray[np.uint8]:
        """What was computed goes to the rows it is meant for, as in `batch.aoi`; rejected rows are in order, too."""
        new.result.fill(Result.UPDATED)
        new.result[started] = Result.INITIALISED
        if beyond is not None:
            new.ok |= beyond
            new.result[beyond] = Result.REJECTED
        run, go = new.run & rows, new.go & rows
        np.copyto(state.dt_s, new.dt_s, where=run)
        taken = go & new.ok
        np.copyto(state._rows[:3], new.rows[:3], where=go)
        np.copyto(state._rows[3:], new.rows[3:], where=taken)
        np.copyto(state.y, state.x_pred, where=go)
        np.copyto(state.y_dot, state.x_dot_pred, where=go)

        through, disabled = rows & ~go, rows & ~run
        np.copyto(state.y, new.x, where=through)
        np.copyto(state.y_dot, 0.0, where=through)
        state.init[disabled] = False
        new.result[go & ~new.ok] = Result.S_NOT_POSITIVE
        new.result[through] = Result.DT_INVALID
        new.result[disabled] = Result.DISABLED
        new.result[~rows] = Result.SKIPPED
        return new.result
