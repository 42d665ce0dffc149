"""The estimate carried on to now: by the age of the sample it rests on, and by the dead time before that.

```
Horizon = max(now − when the sample was taken, 0) + dead time
PositionNow, VelocityNow = the observer's own prediction over Horizon
```
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.result import Result
from softplc.observers.axes import AxisPlace
from softplc.observers.judgement import Judgement
from softplc.observers.kernel import Flags, Kernel
from softplc.observers.modes import Modes
from softplc.observers.published import Published
from softplc.observers.timestep import TimeStep
from softplc.timing import Scan


class Now:
    """Fills PositionNow, VelocityNow and Horizon of n axes that all have a dead time. Arrays[n], seconds."""

    def __init__(self, places: Sequence[AxisPlace], kernel: Kernel, tags: Published) -> None:
        self._kernel, self._tags = kernel, tags
        self._dead_time = np.array([place.spec.dead_time or 0.0 for place in places])
        self._by_stamp: Flags = np.array([place.spec.dt_source == "source" for place in places])
        self._reinit_after = np.array([place.spec.reinit_after for place in places])
        self._arrivals = np.full(len(places), np.nan)  # of the last used sample

    def publish(
        self,
        scan: Scan,
        samples: Judgement,
        time: TimeStep,
        modes: Modes,
        results: NDArray[np.uint8],
        finite: Flags,
    ) -> None:
        """Carry on what this scan stepped, predicted or coasted; what it holds stays as it was carried on last."""
        tags = self._tags
        np.copyto(self._arrivals, samples.arrivals, where=samples.usable)
        horizon = self._age(scan, time)
        ahead = time.predict | modes.ahead
        np.copyto(horizon, np.maximum(horizon, time.dt), where=ahead)  # the state is as old as its step
        np.copyto(horizon, 0.0, where=modes.carried)  # the state is of now
        horizon += self._dead_time
        carried = ((time.rows | ahead | modes.carried) & finite) | modes.passed
        position, velocity = self._kernel.predict(horizon)
        through = (results == Result.DISABLED) | (results == Result.DT_INVALID) | modes.passed
        if through.any():
            position = np.where(through, tags.row("Position"), position)
            velocity = np.where(through, tags.row("Velocity"), velocity)
        for leaf, values in (("PositionNow", position), ("VelocityNow", velocity), ("Horizon", horizon)):
            np.copyto(tags.row(leaf), values, where=carried)

    def _age(self, scan: Scan, time: TimeStep) -> NDArray[np.float64]:
        """How long ago the used sample was taken: by its own stamp where that can be true, or else it arrived."""
        age: NDArray[np.float64] = np.fmax(scan.start - self._arrivals, 0.0)
        if self._by_stamp.any():
            by_stamp = (scan.timestamp - time.timestamps) / 1e9
            sound = self._by_stamp & (by_stamp >= age) & (by_stamp <= age + self._reinit_after)
            np.copyto(age, by_stamp, where=sound)
        return age
