"""When an output is written into a source PLC: on change or every n scans, rate-limited, Good values only."""

from dataclasses import dataclass

from softplc.link import Link
from softplc.sample import StatusCode
from softplc.tags import Image
from softplc.timing import Scan


@dataclass(slots=True)
class WriteBack:
    """One output tag and where it goes. `min_interval` in seconds, `deadband` in the tag's unit."""

    index: int
    link: Link
    position: int
    deadband: float = 0.0
    every_scans: int | None = None
    min_interval: float = 0.0
    _last_value: float | None = None
    _last_time: float = float("-inf")

    def step(self, scan: Scan, outputs: Image) -> None:
        """Hand the value to the link when it is due.

        What still waits to be written is withdrawn when the output is not Good any more. After that, and after a
        reconnect, the next Good value is due.
        """
        if not self.link.statistics.connected:
            self._last_value = None
            return
        if outputs.statuses[self.index] != StatusCode.GOOD:
            if self.link.withdraw(self.position):
                self._last_value = None
            return
        value = float(outputs.values[self.index])
        if self._due(scan, value):
            self.link.put(self.position, value)
            self._last_value, self._last_time = value, scan.start

    def _due(self, scan: Scan, value: float) -> bool:
        if scan.start - self._last_time < self.min_interval:
            return False
        if self.every_scans is not None:
            return scan.number % self.every_scans == 0
        return self._last_value is None or abs(value - self._last_value) > self.deadband
