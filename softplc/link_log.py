"""What the log is told of a link: changes, never states, and of a flapping link only some, with a count."""

from collections.abc import Sequence

import numpy as np
import structlog
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.life import Life
from softplc.sample import StatusCode, status_name

_LOGGED_PER_MINUTE = 6  # changes of a flapping link that are logged; the others are counted

log = structlog.get_logger("softplc.link")

_CLOCK_TOLD_EVERY = 60.0  # seconds between two lines about the source's clock

_NO_DATA = (StatusCode.BAD_WAITING_FOR_INITIAL_DATA, StatusCode.BAD_NO_COMMUNICATION)


class Told:
    """What the log was told of one link."""

    def __init__(self, source: str, clock: Clock) -> None:
        self._source, self._clock = source, clock
        self._state: str | None = None
        self._since: float | None = None
        self._window = -60.0
        self._logged = 0
        self._suppressed = 0
        self._unsaid: tuple[str, str, dict[str, object]] | None = None
        self._words: set[str] = set()
        self._stopped = self._ahead = False
        self._clock_told = float("-inf")

    def up(self) -> None:
        """Tell that the link is up, and for how long it was not."""
        self._state = None
        seconds = {} if self._since is None else {"down_seconds": round(self._clock.monotonic() - self._since, 1)}
        self._since = None
        self._tell("link up", "info", **seconds)

    def lost(self, reason: str) -> None:
        """Tell that the link is down, or still down for another reason."""
        if reason != self._state:
            event = "link down" if self._state is None else "link still down"
            self._since = self._clock.monotonic() if self._since is None else self._since
            self._state = reason
            self._tell(event, "warning", reason=reason)

    def tags(self, names: Sequence[str], before: NDArray[np.uint32], after: NDArray[np.uint32]) -> bool:
        """Tell which tags became Bad or usable again; True when any did."""
        was, now = before >= StatusCode.BAD, after >= StatusCode.BAD
        no_data = np.isin(before, _NO_DATA)
        changed = (was != now) | (now & no_data & (before != after))
        for position in np.flatnonzero(changed):
            if now[position]:
                self._tell("tag bad", "warning", tag=names[int(position)], status=status_name(int(after[position])))
            elif not no_data[position]:
                self._tell("tag good again", "info", tag=names[int(position)])
        return bool(changed.any())

    def life(self, life: Life, names: Sequence[str]) -> None:
        """Tell that the program stopped or runs again, that the source's clock is ahead of ours, or went back."""
        if life.heartbeat is not None and life.heartbeat.stopped != self._stopped:
            self._stopped = life.heartbeat.stopped
            event = "program stopped: its heartbeat stands still" if self._stopped else "program runs again"
            self._tell(event, "warning" if self._stopped else "info")
        if life.stamps is None:
            return
        back, ahead = life.stamps.backwards, life.stamps.ahead
        news = back is not None or (ahead and not self._ahead)
        self._ahead = ahead
        now = self._clock.monotonic()
        if news and now - self._clock_told >= _CLOCK_TOLD_EVERY:
            self._clock_told = now
            if back is not None:
                self._tell("source timestamp went back", "warning", tag=names[back[0]], seconds=round(back[1], 6))
            else:
                self._tell("source clock is ahead of ours", "warning", seconds=round(life.stamps.skew, 3))

    def words(self, event: str, texts: Sequence[str]) -> None:
        """Tell texts that were not told before."""
        for text in texts:
            if text not in self._words:
                self._words.add(text)
                log.warning(event, source=self._source, text=text)

    def catch_up(self) -> None:
        """Tell the last change that was left out once there is room again: the log ends with the true state."""
        if self._unsaid is not None and self._clock.monotonic() - self._window >= 60.0:
            event, level, fields = self._unsaid
            self._suppressed -= 1
            self._tell(event, level, **fields)

    def _tell(self, event: str, level: str, **fields: object) -> None:
        now = self._clock.monotonic()
        if now - self._window >= 60.0:
            self._window, self._logged = now, 0
        if self._logged >= _LOGGED_PER_MINUTE:
            self._suppressed += 1
            self._unsaid = (event, level, fields)
            return
        self._unsaid = None
        self._logged += 1
        more: dict[str, int] = {"suppressed": self._suppressed} if self._suppressed else {}
        self._suppressed = 0
        getattr(log, level)(event, source=self._source, **fields, **more)
