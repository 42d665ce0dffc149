"""Configuration of an OPC-UA source and of a tag in it."""

from collections.abc import Collection, Sequence
from typing import Annotated, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, field_validator

from softplc.clock import Clock
from softplc.drivers.opcua.node import parse_address
from softplc.interfaces import Driver
from softplc.model import Model, Name, PathBeside, Secret


class OpcUaUser(Model):
    """Who logs in at the server."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    """User name."""
    password: Secret
    """Where the password is to be found."""


class OpcUaSecurity(Model):
    """Message security; leave it out for SecurityPolicy None. Paths are as seen from this file's folder."""

    policy: Literal["Basic256Sha256", "Aes128_Sha256_RsaOaep", "Aes256_Sha256_RsaPss"] = "Basic256Sha256"
    """Security policy; the server must offer it."""
    mode: Literal["Sign", "SignAndEncrypt"] = "SignAndEncrypt"
    """Messages are signed, or signed and encrypted."""
    certificate: PathBeside
    """Path of our application certificate (DER or PEM)."""
    private_key: PathBeside
    """Path of its private key (PEM)."""
    server_certificate: PathBeside | None = None
    """Path of the server's certificate; without it the one that the server presents is taken."""


def _is_an_address(node: str) -> str:
    parse_address(node)
    return node


NodeText = Annotated[
    str,
    Field(
        min_length=1,
        json_schema_extra={
            "x-expected": "a node id as in ns=2;s=AxisX.Position, or a browse path as in /Objects/2:X/2:Position"
        },
    ),
    AfterValidator(_is_an_address),
]


class OpcUaHeartbeat(Model):
    """A variable that the PLC's program changes for as long as it runs; what to does not matter."""

    node: NodeText
    """Node id `ns=2;s=PLC.Heartbeat` or `nsu=urn:plc;s=…`, or browse path `/Objects/2:PLC/2:Heartbeat`."""
    index: Annotated[int, Field(ge=0)] | None = None
    """Element of an array variable, from 0."""
    timeout_ms: Annotated[float, Field(ge=10, le=3_600_000)] = 1000.0
    """Unchanged for so long, all samples of the source are Uncertain; for three times as long, Bad, ms."""

    def tag(self, source: str) -> "OpcUaTag":
        """The tag that is read for it."""
        return OpcUaTag(source=source, node=self.node, index=self.index)


class OpcUaSource(Model):
    """A PLC or server that speaks OPC-UA."""

    tells_time: ClassVar[bool] = True  # its samples carry timestamps of its own

    type: Literal["opcua"]
    name: Name
    """How tags refer to it."""
    url: Annotated[
        str,
        Field(
            pattern=r"^opc\.tcp://[^/\s]+",
            json_schema_extra={"x-expected": "an endpoint as in opc.tcp://192.168.0.10:4840"},
        ),
    ]
    """Endpoint, as in opc.tcp://192.168.0.10:4840."""
    mode: Literal["poll", "subscribe"] = "poll"
    """poll: one batched Read in every scan. subscribe: the server reports changes; for slow or many tags."""
    sampling_ms: Annotated[float, Field(ge=0)] | None = None
    """subscribe: sampling interval asked of the server, ms; the task's period when left out."""
    publishing_ms: Annotated[float, Field(gt=0)] | None = None
    """subscribe: publishing interval asked of the server, ms; the task's period when left out."""
    queue_size: Annotated[int, Field(ge=1, le=1000)] = 10
    """subscribe: samples that the server keeps for each tag between two publishings."""
    timeout_ms: Annotated[float, Field(ge=10, le=60_000)] = 500.0
    """A request that takes longer means that the link is lost, ms."""
    connect_timeout_ms: Annotated[float, Field(ge=100, le=60_000)] = 4000.0
    """An attempt to connect that takes longer is given up, ms."""
    stale_after_ms: Annotated[float, Field(ge=10, le=3_600_000)] = 3000.0
    """Without a sign of life from the server for so long its values are no longer current, ms."""
    heartbeat: OpcUaHeartbeat | None = None
    """A variable that shows that the PLC's program runs; leave it out where there is none."""
    user: OpcUaUser | None = None
    """Who logs in; leave it out to be anonymous."""
    security: OpcUaSecurity | None = None
    """Signing and encryption; leave it out for none."""

    @field_validator("url")
    @classmethod
    def _is_an_endpoint(cls, url: str) -> str:
        parts = urlsplit(url)
        if "@" in parts.netloc:
            raise ValueError("the address holds a user name or password; expected them under user:")
        try:
            named = parts.port != 0 and parts.hostname
        except ValueError:
            named = None
        if not named:
            raise ValueError(f"{parts.netloc} is no host and port; expected as in opc.tcp://192.168.0.10:4840")
        return url

    def build(
        self,
        readings: Sequence["OpcUaTag"],
        writings: Sequence["OpcUaTag"],
        clock: Clock,
        period: float,
        stamped: Collection[int] = (),
    ) -> Driver:
        """A driver for one connection; imports asyncua now.

        `stamped`: positions of the readings whose timestamp counts though their value stands still; a subscription
        has new timestamps of these reported, too.
        """
        from softplc.drivers.opcua.driver import OpcUaDriver  # noqa: PLC0415  asyncua takes seconds to import

        return OpcUaDriver(self, readings, writings, clock, period, stamped)


class OpcUaTag(Model):
    """One variable of an OPC-UA source."""

    source: Name
    """Name of an OPC-UA source."""
    node: NodeText
    """Node id `ns=2;s=Axis.Position` or `nsu=urn:plc;s=…`, or browse path `/Objects/2:Axis/2:Position`."""
    index: Annotated[int, Field(ge=0)] | None = None
    """Element of an array variable, from 0; row by row where it has several dimensions."""

    def __str__(self) -> str:
        return self.node if self.index is None else f"{self.node}[{self.index}]"
