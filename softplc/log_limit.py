"""How many lines a minute one matter may have in the log; those that are left out are counted."""


class LogLimit:
    """The room that one matter has: so many lines in a minute. `now` in seconds on the monotonic clock."""

    def __init__(self, per_minute: int = 6) -> None:
        self._per_minute = per_minute
        self._window = float("-inf")
        self._told = 0
        self._left_out = 0

    def ask(self, now: float) -> dict[str, int] | None:
        """None where there is no room for a line, else what the line has to add: how many were left out before."""
        if now - self._window >= 60.0:
            self._window, self._told = now, 0
        if self._told >= self._per_minute:
            self._left_out += 1
            return None
        self._told += 1
        left_out, self._left_out = self._left_out, 0
        return {"suppressed": left_out} if left_out else {}
