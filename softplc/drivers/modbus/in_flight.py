"""Which devices are asked one thing at a time although more is configured: remembered from link to link."""

import structlog

log = structlog.get_logger(__name__)


class InFlightState:
    """Devices, by name, that lost or mixed up replies with several requests in flight; until the process ends."""

    def __init__(self) -> None:
        self._one_at_a_time: set[str] = set()

    def allowed(self, device: str, wanted: int) -> int:
        """How many requests may be in flight."""
        return 1 if device in self._one_at_a_time else wanted

    def lower(self, device: str, reason: str) -> None:
        """From now on one at a time; said once."""
        if device not in self._one_at_a_time:
            self._one_at_a_time.add(device)
            log.warning("modbus device asked one request at a time from now on", device=device, reason=reason)


seen = InFlightState()
