"""One session with one server, from the socket to the activated session and back; opened once, closed once.

The library gives codec, channel and security. What it does with time and trouble is ours, because as it comes it
waits for ever, loops, or goes on as if nothing had happened: the steps of connecting are called one by one under
one deadline, no task of the library's own is started, every request has a timeout, and whatever goes wrong is a
LinkError that says what.
"""

import asyncio
import contextlib
from collections.abc import Coroutine, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeVar
from urllib.parse import urlsplit

from asyncua import ua

from softplc.clock import Clock
from softplc.drivers.opcua.credentials import APPLICATION_NAME, PRODUCT_URI, Credentials
from softplc.drivers.opcua.fast.seam import Request, exchange
from softplc.drivers.opcua.left import LEFT_SESSIONS, session_of
from softplc.drivers.opcua.transport import Transport, make_client
from softplc.errors import LinkError

DEFAULT_PORT: Final = 4840
RENEW_AT: Final = 0.75
"""Part of a secure channel's lifetime after which its token is renewed (OPC 10000-4, 5.6.2.1)."""
SIGN_AND_ENCRYPT: Final = ua.MessageSecurityMode.SignAndEncrypt
NONE: Final = "#None"
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Limits:
    """The most operations that go into one request: the server's limits (OPC 10000-5, 6.3.11), or ours if less."""

    read: int = 5000
    write: int = 1000
    browse: int = 100
    translate: int = 100
    monitor: int = 1000


_MOST_READ: Final = ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead
_LIMITS: Final = (
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerWrite,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerTranslateBrowsePathsToNodeIds,
    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall,
)


class Session:
    """A session with the server at `url`; times in seconds. `namespaces` and `limits` are known once it is open."""

    def __init__(
        self, url: str, credentials: Credentials, clock: Clock, timeout: float, session_timeout: float
    ) -> None:
        self.url = with_port(url)
        self.namespaces: list[str] = []
        self.limits = Limits()
        self._clock = clock
        self._timeout = timeout
        self._credentials = credentials
        self._key = (self.url, credentials.user, credentials.application_uri)
        self._closed = False
        self._renew_at = float("inf")
        self._client = make_client(self.url, timeout)
        self._client.name = self._client.description = APPLICATION_NAME
        self._client.application_uri = credentials.application_uri
        self._client.product_uri = PRODUCT_URI
        self._client.session_timeout = session_timeout * 1000.0
        self._transport: Transport = self._client.uaclient

    async def open(self, connect_timeout: float) -> None:
        """Connect, log in, learn namespaces and limits; each step within `connect_timeout`. Raises LinkError.

        The handshake of TCP and the server's first word have only as long as any request: where nobody is, the next
        attempt can come soon. Logging in may take a small PLC longer.
        """
        client = self._client
        self._transport.set_timeout(min(self._timeout, connect_timeout))
        with link_errors(f"cannot connect to {self.url}"), self._no_endpoint():
            if self._credentials.certificates is not None:
                await self._credentials.certificates.apply(client)
            await client.connect_socket()
            await self._transport.greet(self.url)
            self._transport.set_timeout(connect_timeout)
            await client.open_secure_channel()
            self._schedule_renewal()
            login = {"username": self._credentials.user, "password": self._credentials.password}
            await LEFT_SESSIONS.close_all(self._key, client, self._clock.monotonic(), **login)
            await client.create_session()
            await client.activate_session(**login)
        self._transport.set_timeout(self._timeout)
        await self._learn()
        if self._closed:  # given up meanwhile, while something did not let itself be cancelled
            self._say_farewell()

    async def read(self, nodes: Sequence[ua.ReadValueId], max_age: float = 0.0) -> list[ua.DataValue]:
        """One Read of attributes with source timestamps, fresh from the device unless `max_age` (ms) allows other.

        Raises LinkError.
        """
        parameters = ua.ReadParameters(
            MaxAge=max_age, TimestampsToReturn=ua.TimestampsToReturn.Source, NodesToRead=list(nodes)
        )
        return await self._list("Read", self._transport.session.read(parameters), len(nodes))

    def encode(self, request: Any, response: type, timed: bool = True) -> Request:
        """A request of this session, encoded to be sent again and again; `response` is the type of its answer."""
        return Request(self._transport, request, response, timed)

    async def exchange(self, request: Request) -> bytes:
        """Send an encoded request; the body of its answer, which is of the type due. Raises as the library does."""
        return await exchange(self._transport, request, self._clock.utc_ns())

    def arrival(self) -> tuple[float, int]:
        """Now: monotonic seconds, ns UTC."""
        return self._clock.monotonic(), self._clock.utc_ns()

    async def write(self, values: Sequence[ua.WriteValue]) -> list[ua.StatusCode]:
        """One Write; a status for each value. Raises LinkError."""
        parameters = ua.WriteParameters(NodesToWrite=list(values))
        return await self._list("Write", self._transport.session.write(parameters), len(values))

    async def translate(self, paths: Sequence[ua.BrowsePath]) -> list[ua.BrowsePathResult]:
        """One TranslateBrowsePathsToNodeIds. Raises LinkError."""
        service = self._transport.session.translate_browsepaths_to_nodeids(list(paths))
        return await self._list("TranslateBrowsePathsToNodeIds", service, len(paths))

    async def browse(self, nodes: Sequence[ua.BrowseDescription], references: int) -> list[ua.BrowseResult]:
        """One Browse with at most so many references for each node. Raises LinkError."""
        parameters = ua.BrowseParameters(RequestedMaxReferencesPerNode=references, NodesToBrowse=list(nodes))
        return await self._list("Browse", self._transport.session.browse(parameters), len(nodes))

    async def browse_next(self, points: Sequence[bytes]) -> list[ua.BrowseResult]:
        """One BrowseNext for continuation points. Raises LinkError."""
        parameters = ua.BrowseNextParameters(ReleaseContinuationPoints=False, ContinuationPoints=list(points))
        return await self._list("BrowseNext", self._transport.session.browse_next(parameters), len(points))

    async def create_subscription(self, parameters: ua.CreateSubscriptionParameters) -> ua.CreateSubscriptionResult:
        """CreateSubscription without the library's own publish loop. Raises LinkError."""
        request = ua.CreateSubscriptionRequest(Parameters=parameters)
        service = self._transport.request(request, ua.CreateSubscriptionResponse)
        return (await self._call("CreateSubscription", service)).Parameters

    async def delete_subscription(self, subscription: int) -> None:
        """DeleteSubscriptions of one. Raises LinkError."""
        await self._call("DeleteSubscriptions", self._transport.session.delete_subscriptions([subscription]))

    async def create_monitored_items(
        self, parameters: ua.CreateMonitoredItemsParameters
    ) -> list[ua.MonitoredItemCreateResult]:
        """One CreateMonitoredItems; a result with its status for each item. Raises LinkError."""
        service = self._transport.session.create_monitored_items(parameters)
        return await self._list("CreateMonitoredItems", service, len(parameters.ItemsToCreate))

    async def delete_monitored_items(self, subscription: int, items: list[int]) -> None:
        """One DeleteMonitoredItems. Raises LinkError."""
        parameters = ua.DeleteMonitoredItemsParameters(subscription, items)
        await self._call("DeleteMonitoredItems", self._transport.session.delete_monitored_items(parameters))

    async def publish(self, acknowledgements: list[ua.SubscriptionAcknowledgement]) -> ua.PublishResponse:
        """Wait for the next notification or keep-alive, without timeout. Raises LinkError."""
        response = await self._call("Publish", self._transport.session.publish(acknowledgements))
        with link_errors(f"{self.url}: Publish"):
            response.ResponseHeader.ServiceResult.check()
        return response

    @property
    def password_in_clear(self) -> bool:
        """True when the server has the password sent as it is, over a channel that does not encrypt."""
        if self._credentials.password is None or self._client.security_policy.Mode == SIGN_AND_ENCRYPT:
            return False
        return str(self._client.server_policy(ua.UserTokenType.UserName).SecurityPolicyUri or NONE).endswith(NONE)

    @property
    def renewal_due(self) -> bool:
        """True when the channel's token has reached the age to be renewed."""
        return self._clock.monotonic() >= self._renew_at

    async def renew(self) -> None:
        """Renew the channel's token. Raises LinkError."""
        await self._call("OpenSecureChannel", self._client.open_secure_channel(renew=True))
        self._transport.revolve_security_token()
        self._schedule_renewal()

    async def refresh_namespaces(self) -> None:
        """Learn the NamespaceArray anew. Raises LinkError."""
        self._take_namespaces(*await self.read([_value(ua.ObjectIds.Server_NamespaceArray)]))

    def close(self) -> None:
        """Let go at once; the socket is gone within a second, whatever the server does."""
        if not self._closed:
            self._closed = True
            self._say_farewell()

    def _say_farewell(self) -> None:
        """Close the session, over the next connection where this one is beyond it."""
        session = session_of(self._client, self._clock.monotonic())
        self._transport.farewell(lambda: LEFT_SESSIONS.add(self._key, session))

    async def _learn(self) -> None:
        """How much goes into one Read, and with that all else."""
        (most,) = await self.read([_value(_MOST_READ)])
        at_once = _smaller(self.limits.read, most)
        told: list[ua.DataValue] = []
        for some in batches((*_LIMITS, ua.ObjectIds.Server_NamespaceArray), at_once):
            told += await self.read([_value(node) for node in some])
        ours = (self.limits.write, self.limits.browse, self.limits.translate, self.limits.monitor)
        self.limits = Limits(at_once, *(_smaller(own, data) for own, data in zip(ours, told, strict=False)))
        self._take_namespaces(told[-1])

    def _take_namespaces(self, data: ua.DataValue) -> None:
        uris = data.Value.Value if data.Value is not None else None
        if not isinstance(uris, list) or not uris:
            raise LinkError(f"{self.url}: the server gives no NamespaceArray; expected the list of its namespaces")
        self.namespaces = [str(uri) for uri in uris]

    def _schedule_renewal(self) -> None:
        self._renew_at = self._clock.monotonic() + RENEW_AT * self._client.secure_channel_timeout / 1000.0

    async def _call(self, service: str, call: Coroutine[Any, Any, T]) -> T:
        with link_errors(f"{self.url}: {service}"):
            return await call

    async def _list(self, service: str, call: Coroutine[Any, Any, list[T]], expected: int) -> list[T]:
        results: list[T] = await self._call(service, call) or []
        if len(results) != expected:
            raise LinkError(f"{self.url}: {service} was answered with {len(results)} results; expected {expected}")
        return results

    @contextlib.contextmanager
    def _no_endpoint(self) -> Iterator[None]:
        try:
            yield
        except ua.UaError as error:
            if "No matching endpoints" not in str(error):
                raise
            ours = self._credentials.certificates
            wanted = "SecurityPolicy None" if ours is None else f"{ours.policy} and {ours.mode}"
            raise LinkError(
                f"{self.url}: the server has no endpoint with {wanted}; expected, under security:, one that it has"
            ) from error


async def within(seconds: float, work: Coroutine[Any, Any, T], what: str) -> T:
    """The work's result, or LinkError after so many seconds, even when the work does not let itself be cancelled."""
    task = asyncio.ensure_future(work)
    try:
        done, _ = await asyncio.wait({task}, timeout=seconds)
    except asyncio.CancelledError:
        task.cancel()
        raise
    if done:
        return task.result()
    task.cancel()
    task.add_done_callback(lambda late: late.cancelled() or late.exception())
    raise LinkError(f"{what}: no answer within {seconds:g} s")


@contextlib.contextmanager
def link_errors(what: str) -> Iterator[None]:
    """The edge where the library's errors become LinkErrors; on an answer that is garbage it raises anything."""
    try:
        yield
    except LinkError:
        raise
    except TimeoutError as error:
        raise LinkError(f"{what}: no answer in time") from error
    except ua.UaStatusCodeError as error:
        status = ua.StatusCode(error.code)
        raise LinkError(f"{what}: the server says {status.name}: {status.doc}") from error
    except OSError as error:
        raise LinkError(f"{what}: {error.strerror or error}") from error
    except Exception as error:
        raise LinkError(f"{what}: {type(error).__name__}: {error}") from error


def with_port(url: str) -> str:
    """The address with the port that OPC-UA has registered, where it names none."""
    parts = urlsplit(url)
    return url if parts.port else parts._replace(netloc=f"{parts.netloc.rstrip(':')}:{DEFAULT_PORT}").geturl()


def batches(items: Sequence[T], size: int) -> Iterator[Sequence[T]]:
    """The items in runs of at most `size`."""
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _value(node: int) -> ua.ReadValueId:
    return ua.ReadValueId(NodeId=ua.NodeId(node), AttributeId=ua.AttributeIds.Value)


def _smaller(own: int, told: ua.DataValue) -> int:
    """Our own limit or the server's, where it tells one; 0 and an absent node mean that it has none."""
    value = told.Value.Value if told.Value is not None else None
    return min(own, value) if isinstance(value, int) and value > 0 else own
