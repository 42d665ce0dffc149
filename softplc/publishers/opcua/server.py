"""softplc's OPC-UA server: each snapshot as OPC-UA variables, and writes on their way back as commands."""

import asyncio
import contextlib
import errno
import gc
import ipaddress
import logging
import re
import socket
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import structlog
from asyncua import Server, ua

import softplc
from softplc.errors import SoftplcError
from softplc.exchange import Reader
from softplc.publishers.opcua.access import Access, AllServices, Users
from softplc.publishers.opcua.address_space import NAMESPACE, NAMESPACE_URI, Nodes, TagIndex, node_id
from softplc.publishers.opcua.config import APPLICATION_URI, OpcUaPublisher
from softplc.publishers.opcua.fast.reads import Reads
from softplc.publishers.opcua.fast.seam import proven
from softplc.publishers.opcua.fast.sweep import Sweep
from softplc.publishers.opcua.hardened.channel import Listener
from softplc.publishers.opcua.hardened.decoding import guard_decoding
from softplc.publishers.opcua.hardened.inner import ClosedServer
from softplc.publishers.opcua.hardened.limits import Limits, free_files
from softplc.publishers.opcua.hardened.secured import POLICIES
from softplc.publishers.opcua.hardened.trust import Trust
from softplc.publishers.opcua.own_certificate import load_or_make
from softplc.publishers.opcua.values import TagValues, Watch, utc

_ITEMS_PER_TURN: Final = 256  # tags notified before the loop's other tasks get their turn
_USUAL_INTERVAL_MS: Final = 50.0  # told to clients before the first scan where no interval is configured
_SERVICE_LEVELS: Final = {"all": 255, "late": 150, "some": 100, "none": 1}  # OPC 10000-4, 6.6.2.4.2
"""Healthy; Degraded, as a task misses its deadlines; Degraded, as only some scan; NoData."""
_OVERLOADED: Final = re.compile(r"Tasks\.[^.]*\.Overloaded")
_UNKNOWN_DATE: Final = datetime(1601, 1, 1, tzinfo=UTC)
_OPERATION_LIMITS: Final = (
    "MaxNodesPerRead", "MaxNodesPerWrite", "MaxNodesPerMethodCall", "MaxNodesPerBrowse", "MaxNodesPerRegisterNodes",
    "MaxNodesPerTranslateBrowsePathsToNodeIds", "MaxMonitoredItemsPerCall",
)  # fmt: skip
_NOT_SERVED: Final = (
    "MaxNodesPerHistoryReadData", "MaxNodesPerHistoryReadEvents", "MaxNodesPerHistoryUpdateData",
    "MaxNodesPerHistoryUpdateEvents", "MaxNodesPerNodeManagement",
)  # fmt: skip

log = structlog.get_logger(__name__)


class OpcUaServer:
    """Publisher of every tag over OPC-UA; read-only but for configured users and writable tags.

    Without `fast` every value is coded by itself, as it is with an asyncua that the fast path was not proven on.
    """

    def __init__(
        self, config: OpcUaPublisher, reader: Reader, limits: Limits | None = None, *, fast: bool = True
    ) -> None:
        self._fast = fast
        self._config, self._reader = config, reader
        self._limits = limits or Limits()
        self._server: Any = None  # asyncua's, once it is built
        self._space: Any = None
        self._listener: Listener | None = None
        self._values = TagValues(reader.table, reader.clock.utc_ns())
        self._watch = Watch({}, 0.0)
        self._sweep: Sweep | None = None
        self._second = 0
        self._service_level = -1
        self._overloaded = [index for index, tag in enumerate(reader.table) if _OVERLOADED.fullmatch(tag.name)]

    async def open(self) -> str:
        """Build the address space and listen. Raises SoftplcError when the address is not to be had."""
        logging.getLogger("asyncua").setLevel(logging.CRITICAL + 1)  # it logs every client's every mistake
        guard_decoding()
        host, port = self._config.host, self._config.port
        self._heed_files()
        inner = ClosedServer(Users(self._config.users), self._limits)
        self._secure(inner)
        self._listener = Listener(inner, host, port, self._limits)
        try:
            await self._listener.bind()
            await self._build(inner, self._listener)
            await self._listener.start()
        except OSError as error:
            await self.close()
            raise SoftplcError(f"OPC-UA server cannot listen on {host}:{port}: {_explain(error)}") from error
        except BaseException:
            await self.close()
            raise
        await self.publish()
        self._warn_of_network()
        return self._url()

    async def publish(self) -> None:
        """Serve the newest snapshot, and notify those who monitor what changed."""
        if self._server is None:
            return
        clock = self._reader.clock
        now = clock.utc_ns()
        snapshot = self._reader.snapshot()
        changes = self._values.take(snapshot, now)
        if changes is not None and self._config.interval_ms is None:
            self._watch.interval = min((scan.period for scan in snapshot.scans if scan), default=self._watch.interval)
        due = self._watch.due(changes, clock.monotonic())
        if self._sweep is not None and (changes is not None or self._sweep.sampled):
            self._sweep.look()
        for number, index in enumerate(due, start=1):
            node = self._space[node_id(self._reader.table.tags[index].name)]
            await _notify(node.attributes[ua.AttributeIds.Value], self._values.data_value(index))
            if not number % _ITEMS_PER_TURN:
                await asyncio.sleep(0)
        if now // 1_000_000_000 != self._second:
            self._second = now // 1_000_000_000
            await self._tell_time(now)
        await self._tell_service_level(now)

    @property
    def slow(self) -> tuple[int, int]:
        """How many Reads, and messages with data changes, were coded value by value instead of in arrays."""
        if self._sweep is None or self._server is None:
            return 0, 0
        return self._server.iserver.reads.slow, self._sweep.slow

    async def close(self) -> None:
        """Stop listening and drop the clients."""
        listener, server = self._listener, self._server
        self._listener = self._server = None
        if listener is not None:
            await listener.stop()
        if server is not None:
            await server.iserver.stop()

    def _secure(self, inner: ClosedServer) -> None:
        """Certificate, key and trust, where they are configured. Raises ConfigError."""
        security, clock = self._config.security, self._reader.clock
        if security is None:
            return
        inner.certificate, inner.private_key = load_or_make(security, self._config.host, utc(clock.utc_ns()))
        inner.trust = Trust(security, inner.certificate, clock)
        inner.trust.make_folders()

    def _policies(self) -> list[Any]:
        security = self._config.security
        none = [ua.SecurityPolicyType.NoSecurity]
        if security is None:
            return none
        return [*POLICIES, *(none if security.none else ())]

    def _url(self) -> str:
        host = self._config.host
        return f"opc.tcp://{f'[{host}]' if ':' in host else host}:{self._config.port}"

    async def _build(self, inner: ClosedServer, listener: Listener) -> None:
        """Everything that a client can see; the garbage collector would take longer than all the rest of it."""
        self._space = inner.aspace
        with _no_garbage_collection():
            self._server = server = Server(iserver=inner)
            server.product_uri = "urn:softplc"
            server.manufacturer_name = server.name = "softplc"
            server.application_type = ua.ApplicationType.Server
            server._application_uri = APPLICATION_URI
            server.set_endpoint(self._url())
            server.set_security_policy(self._policies(), permission_ruleset=AllServices())
            await server.init()
            if await server.register_namespace(NAMESPACE_URI) != NAMESPACE:
                raise SoftplcError(f"{NAMESPACE_URI} is not namespace {NAMESPACE}: another one was registered first")
            interval_ms = self._config.interval_ms or _USUAL_INTERVAL_MS
            Nodes(inner.aspace, self._values, interval_ms).build()
        self._watch = inner.watch = Watch(TagIndex(self._reader.table), interval_ms / 1000.0)
        if self._fast and proven():
            inner.reads = Reads(self._values, self._reader.clock, self._limits.operations)
            inner.sweep = self._sweep = Sweep(self._values, self._watch)
        inner.access = Access(self._reader, self._values, inner.watch.index)
        await self._describe_server(server)
        await server._setup_server_nodes()
        listener.set_policies(server._policies)
        await inner.start()
        await self._tell_start(self._reader.clock.utc_ns())

    async def _describe_server(self, server: Server) -> None:
        await server.set_build_info("urn:softplc", "softplc", "softplc", softplc.__version__, "", _UNKNOWN_DATE)
        limits = ua.ObjectIds
        for names, value in ((_OPERATION_LIMITS, self._limits.operations), (_NOT_SERVED, 0)):
            for name in names:
                node = getattr(limits, f"Server_ServerCapabilities_OperationLimits_{name}")
                await self._write(node, ua.Variant(value, ua.VariantType.UInt32))

    async def _tell_start(self, now: int) -> None:
        status = replace(self._read(ua.ObjectIds.Server_ServerStatus), StartTime=utc(now))
        await self._write(ua.ObjectIds.Server_ServerStatus, ua.Variant(status), now)
        await self._write(
            ua.ObjectIds.Server_ServerStatus_StartTime, ua.Variant(utc(now), ua.VariantType.DateTime), now
        )

    async def _tell_time(self, now: int) -> None:
        status = replace(self._read(ua.ObjectIds.Server_ServerStatus), CurrentTime=utc(now))
        await self._write(ua.ObjectIds.Server_ServerStatus, ua.Variant(status), now)
        await self._write(
            ua.ObjectIds.Server_ServerStatus_CurrentTime, ua.Variant(utc(now), ua.VariantType.DateTime), now
        )

    async def _tell_service_level(self, now: int) -> None:
        alive = self._values.snapshot.alive if self._values.snapshot else ()
        state = "all" if all(alive) else "some" if any(alive) else "none"
        if state == "all" and any(self._values.values[index] == 1.0 for index in self._overloaded):
            state = "late"
        level = _SERVICE_LEVELS[state]
        if level != self._service_level:
            self._service_level = level
            await self._write(ua.ObjectIds.Server_ServiceLevel, ua.Variant(level, ua.VariantType.Byte), now)

    def _read(self, node: int) -> Any:
        value = self._space.read_attribute_value(ua.NodeId(node), ua.AttributeIds.Value)
        return value.Value.Value

    async def _write(self, node: int, variant: Any, now: int | None = None) -> None:
        stamp = None if now is None else utc(now)
        value = ua.DataValue(variant, SourceTimestamp=stamp, ServerTimestamp=stamp)
        await self._space.write_attribute_value(ua.NodeId(node), ua.AttributeIds.Value, value)

    def _heed_files(self) -> None:
        """Take no more connections than half of the files that are left; the rest is for the other servers."""
        wanted, self._limits = self._limits.connections, self._limits.within(free_files() // 2)
        if self._limits.connections < wanted:
            log.warning(
                "opcua server takes fewer connections: this process may open few files (ulimit -n)",
                connections=self._limits.connections,
                otherwise=wanted,
            )

    def _warn_of_network(self) -> None:
        security = self._config.security
        if not _is_loopback(self._config.host) and (security is None or security.none):
            log.warning(
                "opcua server is open to the network without encryption: everyone there reads, passwords go in clear",
                host=self._config.host,
                port=self._config.port,
                users=len(self._config.users),
            )


async def _notify(attribute: Any, value: Any) -> None:
    for handle, callback in list(attribute.datachange_callbacks.items()):
        await callback(handle, value)


@contextlib.contextmanager
def _no_garbage_collection() -> Iterator[None]:
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


def _explain(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "the port is in use; stop the program that has it, or configure another port"
    if error.errno == errno.EACCES:
        return "not permitted; ports below 1024 need a privilege, another port does not"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this machine does not have that address; configure one of its own, or 0.0.0.0 for all"
    if isinstance(error, socket.gaierror):
        return "the host name is not known; configure an address of this machine"
    return error.strerror or str(error)
