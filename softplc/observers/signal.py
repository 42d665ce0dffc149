"""Conditioning of measurements before the observer: rollover, turns, jumps, steps and small changes.

```
u = read + C·round((u' + v·Δt − read)/C)     counter: the turn nearest to where the axis is expected
z = u + M·round((z' + (u − u') − u)/M)       modulo: the same position, near the observer's own turn
|z − z'| − quantum > max_rate·Δt             rejected; after so many in a row the observer starts anew
p = min(max(p', z − quantum), z + quantum)   play of one step to either side
p = p' where |p − p'| < dead_band
```
C: span of the counter, M: one turn, ' : of the last used sample, v: median of its last three speeds, which one wild
sample does not change, Δt: measured time since then, p: what the observer gets.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softplc.observers.kernel import Flags
from softplc.sample import Reason, StatusCode
from softplc.timing import Scan

if TYPE_CHECKING:
    from softplc.observers.axes import AxisPlace
    from softplc.observers.judgement import Judgement

_Numbers = NDArray[np.float64]


class Signal:
    """The axes of a group that have a `signal`: m of n. Own arrays[m], those of `samples` [n].

    `anew` bool[n]: the observer is to start anew with this scan's sample, None where none is.
    """

    def __init__(self, places: Sequence["AxisPlace"]) -> None:
        chosen = [(row, place.spec, place.spec.signal) for row, place in enumerate(places) if place.spec.signal]
        self._n, m = len(places), len(chosen)
        self._rows = np.array([row for row, _, _ in chosen], np.intp)
        specs = [spec for _, spec, _ in chosen]
        signals = [signal for _, _, signal in chosen if signal is not None]

        def numbers(values: Any) -> _Numbers:
            return np.array(list(values), np.float64)

        self._counted = np.flatnonzero([signal.counter is not None for signal in signals])
        self._turning = np.flatnonzero([signal.modulo is not None for signal in signals])
        self._C = numbers(signals[row].counter for row in self._counted)
        self._zero = numbers(signals[row].counter_at_0 for row in self._counted)
        self._M = numbers(signals[row].modulo for row in self._turning)
        self._fastest = numbers(signals[row].fastest for row in self._counted)
        ranges = [specs[row].range for row in self._counted]
        self._ambiguous: Flags = np.array(  # a range of half a span has room for one turn alone
            [
                signals[row].modulo is not None or low_high is None or low_high[1] - low_high[0] > span / 2.0
                for row, low_high, span in zip(self._counted, ranges, self._C, strict=True)
            ],
            np.bool_,
        )
        self._doubted: Flags = np.zeros(len(self._counted), np.bool_)
        self._by_counter: Flags = np.isin(self._turning, self._counted)
        self._quantum = numbers(signal.quantum for signal in signals)
        self._dead_band = numbers(signal.dead_band for signal in signals)
        self._max_rate = numbers(np.inf if signal.max_rate is None else signal.max_rate for signal in signals)
        self._most = np.array([signal.max_rate_samples for signal in signals], np.int64)
        self._wraps = bool(len(self._counted) or len(self._turning))
        self._limits = bool(np.isfinite(self._max_rate).any())
        self._plays, self._sticks = bool(self._quantum.any()), bool(self._dead_band.any())
        self._by_arrival: Flags = np.array([spec.dt_source == "arrival" for spec in specs])
        self._by_stamp: Flags = np.array([spec.dt_source in ("source", "arrival") for spec in specs])
        self._any_by_stamp = bool(self._by_stamp.any())
        self._reinit_after = numbers(spec.reinit_after for spec in specs)

        self._u, self._z, self._passed = (np.full(m, np.nan) for _ in range(3))  # of the last used sample
        self._speeds, self._v = np.zeros((3, m)), np.zeros(m)
        self._start, self._arrival = np.full(m, np.nan), np.full(m, np.nan)
        self._stamp = np.zeros(m, np.int64)
        self._in_a_row = np.zeros(m, np.int64)
        self._wild, self._wild_stamp = np.full(m, np.nan), np.zeros(m, np.int64)  # the last rejected sample
        self._dt, self._old = np.zeros(m), np.zeros(m, np.bool_)
        self._repeated: Flags = np.zeros(m, np.bool_)
        self._new_u = np.zeros(m)
        self._unseen_turns: Flags = np.zeros(len(self._counted), np.bool_)
        self.anew: Flags | None = None

    @property
    def chosen(self) -> tuple[NDArray[np.intp], ...]:
        """The rows of the group's axes that the arrays here are for: all of them, those with a counter."""
        return self._rows, self._rows[self._counted]

    def adopt(self, other: "Signal", rows: NDArray[np.intp]) -> None:
        """Go on for these rows of another group: a counter is in the turn in which it was."""
        at = np.searchsorted(other._rows, rows[self._rows])
        self._u[:], self._z[:], self._passed[:] = other._u[at], other._z[at], other._passed[at]
        self._start[:], self._arrival[:], self._stamp[:] = other._start[at], other._arrival[at], other._stamp[at]
        self._speeds[:], self._v[:] = other._speeds[:, at], other._v[at]
        self._doubted[:] = other._doubted[np.searchsorted(other._counted, at[self._counted])]

    def unwrap(self, scan: Scan, samples: "Judgement", unseen: _Numbers) -> _Numbers:
        """Positions in place of what was read, into `samples.z`; returns [n] what the range is to be judged of.

        `unseen` [n]: how long the observer has had nothing to go on by at the last scan, s; it starts anew with
        reinit_after.
        """
        self.anew = None
        np.copyto(samples.z, samples.read)
        self._measure(scan, samples, unseen)
        if not self._wraps:
            return samples.z
        read = samples.read[self._rows]
        moved = np.where(self._old, 0.0, self._v * self._dt)
        u, c, t = read, self._counted, self._turning
        if len(c):
            self._out_of_sight(scan, c)
            counts = np.abs(read[c] - self._zero) <= self._C
            read[c] = np.where(counts, read[c], np.nan)  # no counter of that span shows it
            u = read.copy()
            u[c] += self._C * _whole((self._u[c] + moved[c] - read[c]) / self._C)
        self._new_u = z = u
        if len(t):
            expected = self._z[t] + np.where(self._by_counter, u[t] - self._u[t], moved[t])
            first = np.isnan(expected)
            z = u.copy()
            z[t] += self._M * _whole(np.where(first, -np.floor(u[t] / self._M), (expected - u[t]) / self._M))
        samples.z[self._rows] = z
        if not len(t):
            return samples.z
        judged = samples.z.copy()
        judged[self._rows[t]] = read[t]
        return judged

    def _out_of_sight(self, scan: Scan, c: NDArray[np.intp]) -> None:
        """Notes the counters that may have moved half a span since their last used sample, for longer than a gap."""
        waited = scan.start - self._start[c]
        far = waited * self._fastest >= self._C / 2.0
        self._unseen_turns = far & self._ambiguous & (waited - scan.period > self._reinit_after[c])

    def _tell_doubt(self, samples: "Judgement") -> None:
        """Which turn it is nobody knows any more, until Reset or homing says where the axis is."""
        rows = self._rows[self._counted]
        self._doubted |= self._unseen_turns & samples.usable[rows]
        if self._doubted.any():
            told = rows[self._doubted]
            told = told[samples.usable[told] & (samples.reason[told] == Reason.NONE)]
            samples.status[told], samples.reason[told] = StatusCode.UNCERTAIN_SUB_NORMAL, Reason.TURNS_UNKNOWN

    def _measure(self, scan: Scan, samples: "Judgement", unseen: _Numbers) -> None:
        """Time since the last used sample, by the axis' own kind of clock; whether this is that sample again."""
        waited = scan.start - self._start  # NaN before the first
        self._dt = waited
        if self._any_by_stamp:
            since = np.where(
                self._by_arrival,
                samples.arrivals[self._rows] - self._arrival,
                (samples.timestamps[self._rows] - self._stamp) / 1e9,
            )
            sound = self._by_stamp & (since > 0.0) & (since <= waited + self._reinit_after)
            self._dt = np.where(sound, since, waited)
            self._repeated = self._by_stamp & (since == 0.0)
        gap = unseen[self._rows] + max(scan.dt, 0.0) - scan.period
        self._old = np.isnan(waited) | ~(gap <= self._reinit_after)

    def judge(self, samples: "Judgement", low: _Numbers, high: _Numbers) -> Flags | None:
        """Samples that are rejected as too fast, bool[n], None for none; one after many is let into `samples.usable`.

        `low` and `high` are the ranges [n].
        """
        if not self._limits:
            return None
        rows = self._rows
        jump = np.abs(samples.z[rows] - self._z) - self._quantum
        fast = (jump > self._max_rate * np.maximum(self._dt, 0.0)) & ~self._old
        if not (fast.any() or self._in_a_row.any()):
            return None
        read, stamp = samples.read[rows], samples.timestamps[rows]
        known = (samples.input_status[rows] < np.uint32(StatusCode.BAD)) & np.isfinite(samples.z[rows])
        fast &= known
        again = known & np.where(fast, self._in_a_row >= self._most, self._old & (self._in_a_row > 0))
        again &= (read >= low[rows]) & (read <= high[rows])  # it will be where it says itself
        if again.any():
            self._start_anew(samples, again)
            samples.usable[rows[again]] = True
        fast &= ~again
        # A source that is slower than the scans repeats one wild sample many times; one that stays becomes old.
        self._in_a_row[fast & ((read != self._wild) | (stamp != self._wild_stamp))] += 1
        self._in_a_row[samples.usable[rows] & ~fast] = 0
        np.copyto(self._wild, read, where=fast)
        np.copyto(self._wild_stamp, stamp, where=fast)
        rejected = np.zeros(self._n, np.bool_)
        rejected[rows] = fast
        return rejected

    def _start_anew(self, samples: "Judgement", which: Flags) -> None:
        """As after a start of the service: a counter is where it says itself."""
        rows, read = self._rows, samples.read[self._rows]
        self._forget(which)
        place = read.copy()
        place[self._turning] = np.mod(read[self._turning], self._M)
        np.copyto(self._new_u, read, where=which)
        samples.z[rows[which]] = place[which]
        self.anew = np.zeros(self._n, np.bool_) if self.anew is None else self.anew
        self.anew[rows[which]] = True

    def take(self, scan: Scan, samples: "Judgement") -> None:
        """Remember the samples that are used, and pass on into `samples.z` what the observer is to see of them."""
        rows = self._rows
        z, used = samples.z[rows], samples.usable[rows]
        if len(self._counted):
            self._tell_doubt(samples)
        if self._wraps:
            self._follow(z, used & ~self._repeated)
        self._pass_on(samples, z, used)
        np.copyto(self._z, z, where=used)
        fresh = used & ~self._repeated
        np.copyto(self._start, scan.start, where=fresh)
        if self._any_by_stamp:
            np.copyto(self._arrival, samples.arrivals[rows], where=fresh)
            np.copyto(self._stamp, samples.timestamps[rows], where=fresh)

    def _follow(self, z: _Numbers, fresh: Flags) -> None:
        """How fast the axis is: the median of three, so that one wild sample does not lead to the wrong turn."""
        known = fresh & (self._dt > 0.0) & ~self._old
        np.copyto(self._speeds, 0.0, where=fresh & self._old)
        speed = (z - self._z) / self._dt
        for older, newer in ((0, self._speeds[1]), (1, self._speeds[2]), (2, speed)):
            np.copyto(self._speeds[older], newer, where=known)
        a, b, c = self._speeds
        self._v = np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c))
        np.copyto(self._u, self._new_u, where=fresh)

    def _pass_on(self, samples: "Judgement", z: _Numbers, used: Flags) -> None:
        """Play and dead band, from what was passed on last."""
        if not (self._plays or self._sticks):
            return
        last = np.where(self._old | np.isnan(self._passed), z, self._passed)
        passed = z
        if self._plays:
            passed = np.minimum(np.maximum(last, z - self._quantum), z + self._quantum)
        if self._sticks:
            passed = np.where(np.abs(passed - last) < self._dead_band, last, passed)
        np.copyto(self._passed, passed, where=used)
        samples.z[self._rows] = np.where(used, passed, z)

    def shift(self, by: _Numbers) -> None:
        """The observer's origin moved: its positions grew by `by` [n]."""
        own = by[self._rows]
        self._z += own
        self._passed += own

    def clear(self, rows: Flags) -> None:
        """As at the start of the service, for these axes [n]."""
        self._forget(rows[self._rows])

    def _forget(self, which: Flags) -> None:
        for array in (self._u, self._z, self._passed, self._start, self._wild):
            array[which] = np.nan
        self._speeds[:, which] = 0.0
        self._v[which] = 0.0
        self._in_a_row[which] = 0
        self._old[which] = True
        self._doubted[which[self._counted]] = False
        self._unseen_turns[which[self._counted]] = False


def _whole(turns: _Numbers) -> _Numbers:
    """The nearest whole number; 0 where there is none."""
    turns = np.rint(turns)
    np.copyto(turns, 0.0, where=~np.isfinite(turns))
    return turns
