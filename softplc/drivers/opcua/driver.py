"""Reads and writes the variables of one OPC-UA server: one batched Read for each scan, or a subscription.

`mode: poll` asks for all variables in every `read`, so its values and statuses are of this scan.
`mode: subscribe` keeps an image of the newest values that the server reported, and `read` copies it. A value that
does not change and a server that is gone look alike, so a server that has had nothing to report for PROOF_AFTER has
to answer for its clock first, and for some of the variables (`witnesses.py`): one that changed without a report means
that the subscription is dead. The subscription itself has `stale_after_ms` for a notification or a keep-alive. One
variable that falls silent alone is found by reading all of them in turn (`patrol.py`).

The driver does not reconnect: whatever is wrong with the connection is a LinkError, and the next connection is a
new driver. Of one tag's trouble the connection takes no notice: the tag is Bad and is looked for again every
REBIND seconds, for a PLC's server may be up before its program is.
"""

import asyncio
import contextlib
import math
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.drivers.opcua.binding import Binding, bind, group, put, server_time
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag
from softplc.drivers.opcua.credentials import Credentials
from softplc.drivers.opcua.fast.notification import Changes, Published
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.fast.seam import proven
from softplc.drivers.opcua.patrol import Patrol
from softplc.drivers.opcua.reading import Reads, plan_reads
from softplc.drivers.opcua.session import Session, within
from softplc.drivers.opcua.subscription import Subscription
from softplc.drivers.opcua.types import first_types
from softplc.drivers.opcua.witnesses import Witnesses
from softplc.drivers.opcua.writing import Writings
from softplc.errors import LinkError
from softplc.interfaces import Positions
from softplc.sample import is_bad
from softplc.tags import Image

REBIND: Final = 5.0
"""Seconds between two attempts to bind the tags that have a problem, and between two looks at the channel's age."""
PROOF_AFTER: Final = 0.1
"""Seconds without any notification, or a scan if that is longer, after which `read` asks the server for its clock."""
MANY_READS: Final = 4  # requests of one scan, one after another; more are worth a remark
SHORTEST_SESSION: Final = 30.0
"""Seconds without a request after which the server may drop the session: short, so that no dead one fills it up."""


class OpcUaDriver:
    """One connection to an OPC-UA server, after the Driver contract; `period` in seconds.

    Raises ConfigError when a secret or a certificate is not where the configuration says.
    """

    def __init__(
        self,
        config: OpcUaSource,
        readings: Sequence[OpcUaTag],
        writings: Sequence[OpcUaTag],
        clock: Clock,
        period: float,
        stamped: Collection[int] = (),
    ) -> None:
        self._config = config
        self._stamped = frozenset(stamped)
        self._clock = clock
        self._period = period
        self._readings = group(readings, first_types(config))
        self._session = Session(
            config.url,
            Credentials.load(config.user, config.security),
            clock,
            config.timeout_ms / 1000.0,
            max(SHORTEST_SESSION, 4.0 * period),
        )
        self._sampling = period if config.sampling_ms is None else config.sampling_ms / 1000.0
        self._reads: Reads = ()
        self.slow = SlowState()
        self._writings = Writings(self._session, writings, self.slow)
        self._subscription: Subscription | None = None
        self._latest = Image(len(readings))
        self._changes = Changes(self._readings, self._latest)
        self._witnesses = Witnesses(self._session, self._readings, self._latest, clock)
        self._patrol = Patrol(self._session, self._readings, self._latest, clock, self.slow)
        self._patrolling: asyncio.Task[None] | None = None
        self._answered = -math.inf
        self._awaited: set[int] = set()
        self._fault: LinkError | None = None
        self._chores: asyncio.Task[None] | None = None
        self._chores_at = clock.monotonic() + REBIND

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with single tags: what was found, what would be right. Changes while connected."""
        told = [binding.trouble for binding in self._readings if binding.trouble]
        return (*told, *self._writings.problems)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What works, but not as one would wish: known once the driver is open."""
        told: list[str] = []
        if self._session.password_in_clear:
            told.append("the password goes over the network in clear text; expected security: with SignAndEncrypt")
        if self._subscription is not None and self._subscription.sampling > 1.5 * self._sampling:
            slow, asked = self._subscription.sampling * 1000.0, self._sampling * 1000.0
            told.append(f"the server samples every {slow:g} ms, {asked:g} ms were asked for")
        if self._subscription is None and len(self._reads) > MANY_READS:
            each = f"a Read brings at most {self._session.limits.read} nodes (MaxNodesPerRead)"
            told.append(f"{each}: every scan waits for {len(self._reads)} answers in turn; expected mode: subscribe")
        return tuple(told)

    @property
    def writes_at_once(self) -> int:
        """The server's limit for one request."""
        return self._session.limits.write

    @property
    def slow_path(self) -> int:
        """Messages and values that the library's decoder took, one by one."""
        return self.slow.messages + self.slow.values

    @property
    def skipped(self) -> int:
        """Samples that a newer one superseded before a scan could take them (subscribe only)."""
        return 0 if self._subscription is None else self._subscription.skipped + self._changes.skipped

    async def open(self) -> None:
        """Connect, resolve every tag and check its type; a subscription waits for its first values.

        Raises LinkError, at the latest after `connect_timeout_ms`.
        """
        seconds = self._config.connect_timeout_ms / 1000.0
        try:
            await within(seconds, self._open(seconds), f"cannot connect to {self._session.url}")
        except BaseException:
            await self.close()
            raise

    async def read(self, into: Image) -> None:
        """Fill `into` with the newest samples. Raises LinkError when the connection is of no more use."""
        self._look_after()
        if self._subscription is not None:
            self._subscription.check()
            await self._prove_life(self._subscription)
        for part in self._reads:
            await part.read(self._latest)
        into.take_over(self._latest)

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Write numbers as each variable's own type; one that does not fit it is not sent and BadOutOfRange.

        Returns the raw StatusCode of each. Raises LinkError when the connection is of no more use.
        """
        self._look_after()
        return await self._writings.write(positions, values)

    async def close(self) -> None:
        """Let go at once and without raising; what the server is told goes on in the background for a second."""
        for task in (self._chores, self._patrolling):
            if task is not None:
                task.cancel()
        if self._subscription is not None:
            self._subscription.close()
        self._session.close()

    async def _open(self, connect_timeout: float) -> None:
        deadline = self._clock.monotonic() + connect_timeout
        await self._session.open(connect_timeout)
        await bind(self._session, self._readings)
        await self._writings.bind(self._readings)
        if self._config.mode == "subscribe":
            await self._subscribe()
            await self._await_first_values(deadline)
        else:
            self._plan()

    def _plan(self) -> None:
        """Read every resolved variable, those with a problem too: its status is the server's, and its end is seen.

        With a subscription only those about which it fell silent.
        """
        found = [binding for binding in self._readings if binding.node is not None] or [server_time()]
        for binding in self._readings:
            if binding.node is None:
                self._latest.fail(binding.status, (position for position, _ in binding.uses))
        if self._subscription is not None:
            found = [binding for binding in found if binding.polled]
        self._reads = plan_reads(self._session, found, self._reads, self.slow)

    async def _subscribe(self) -> None:
        config = self._config
        publishing = self._period if config.publishing_ms is None else config.publishing_ms / 1000.0
        stale_after = config.stale_after_ms / 1000.0
        whole = self._take_changes if proven() else None
        self._subscription = Subscription(
            self._session, self._clock, publishing, stale_after, self._take, self.slow, whole
        )
        await self._subscription.open()
        await self._monitor(self._readings)
        self._patrolling = asyncio.get_running_loop().create_task(
            self._patrol.run(self._subscription.grace, self._poll), name="opcua patrol"
        )
        self._patrolling.add_done_callback(self._done)

    async def _monitor(self, bindings: Sequence[Binding]) -> None:
        """Have these reported where they exist; the others show why they are not."""
        assert self._subscription is not None
        ready = [binding for binding in bindings if binding.node is not None and not is_bad(binding.status)]
        self._awaited |= {binding.handle for binding in ready}
        stamped = [any(position in self._stamped for position, _ in binding.uses) for binding in ready]
        await self._subscription.monitor(ready, stamped, self._sampling, self._config.queue_size)
        for binding in bindings:
            if not binding.monitored:
                self._awaited.discard(binding.handle)
                self._latest.fail(binding.status, (position for position, _ in binding.uses))
        self._patrol.renew()

    async def _poll(self, silent: Sequence[Binding]) -> None:
        """Read these from now on: the subscription fell silent about them."""
        assert self._subscription is not None
        for binding in silent:
            binding.monitored, binding.polled = False, True
        await self._subscription.forget(silent)
        self._plan()

    async def _await_first_values(self, deadline: float) -> None:
        """Give the subscription time to prove itself with data; what does not come stays BadWaitingForInitialData."""
        assert self._subscription is not None
        seconds = 2.0 * self._subscription.publishing + self._config.timeout_ms / 1000.0
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(seconds, 0.5 * (deadline - self._clock.monotonic()))):
                while self._awaited and self._subscription.fault is None:
                    await self._subscription.news.wait()
                    self._subscription.news.clear()
        self._subscription.check()

    async def _prove_life(self, subscription: Subscription) -> None:
        """Wait for an answer from a server that is silent. The link takes no values for current until it came.

        Of an answer that took long nobody knows when it was given, nor of the reports that came with it: the server
        is asked once more, for everything.
        """
        limit = max(self._period, PROOF_AFTER)
        silent_since = max(subscription.last_sign, self._answered)
        if self._clock.monotonic() - silent_since <= limit:
            return
        asked = self._clock.monotonic()
        grace = subscription.grace
        self._answered = await self._witnesses.ask(self._witnesses.some(), grace)
        if self._answered - asked > limit:
            self._answered = await self._witnesses.ask(self._witnesses.everybody(), grace)

    def _take(self, handle: int, data: ua.DataValue, arrival: float) -> None:
        self._awaited.discard(handle)
        self._witnesses.reported(handle)
        put(self._readings[handle], data, self._latest, arrival, self._clock.utc_ns())

    def _take_changes(self, body: bytes, message: Published, arrival: float) -> None:
        before = self._changes.values
        handles = self._changes.take(body, message, arrival, self._clock.utc_ns())
        self.slow.values += self._changes.values - before
        self._awaited.difference_update(handles)
        self._witnesses.reported_all(handles)

    def _look_after(self) -> None:
        """Start the chores when they are due; raise what they found wrong with the connection."""
        if self._fault is not None:
            raise self._fault
        now = self._clock.monotonic()
        due = now >= self._chores_at or self._session.renewal_due
        if due and (self._chores is None or self._chores.done()):
            self._chores_at = now + REBIND
            self._chores = asyncio.get_running_loop().create_task(self._do_chores(), name="opcua chores")
            self._chores.add_done_callback(self._done)

    def _done(self, task: "asyncio.Task[None]") -> None:
        """What went on in the background ended: the connection's end, unless it was to."""
        error = None if task.cancelled() else task.exception()
        if isinstance(error, LinkError):
            self._fault = error
        elif error is not None:
            self._fault = LinkError(f"{self._session.url}: a defect: {error!r}")

    async def _do_chores(self) -> None:
        """Renew the channel's token, and look anew for what has a problem."""
        if self._session.renewal_due:
            await self._session.renew()
        lost = [binding for binding in self._readings if binding.problem]
        if not lost and not self._writings.lost:
            return
        await self._session.refresh_namespaces()
        await bind(self._session, lost)
        await self._writings.bind(self._readings)
        if self._subscription is not None:
            await self._monitor([binding for binding in lost if not (binding.monitored or binding.polled)])
        self._plan()
