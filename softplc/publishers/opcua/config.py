"""Configuration of the OPC-UA server."""

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from softplc.exchange import Reader
from softplc.interfaces import Publisher
from softplc.model import Host, Model, PathBeside, Secret

APPLICATION_URI: Final = "urn:softplc:server"


class OpcUaServerUser(Model):
    """Someone who may write the writable tags after logging in; everybody else only reads."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    """User name."""
    password: Secret
    """Where the password is to be found."""


class OpcUaServerSecurity(Model):
    """Signed and encrypted channels, and which clients may open one. Paths are as seen from this file's folder."""

    certificate: PathBeside
    """Path of the server's certificate (DER or PEM). Where it and its key are missing, both are made at the start."""
    private_key: PathBeside
    """Path of its private key (PEM)."""
    trusted: PathBeside
    """Folder with the certificates of the clients that may connect, or of those who issue them (DER or PEM)."""
    rejected: PathBeside | None = None
    """Folder that receives the certificates of clients that were refused, at most 100; none is kept when left out."""
    none: bool = False
    """Whether SecurityPolicy None is served as well, so that strangers read without a certificate."""

    @model_validator(mode="after")
    def _folders_differ(self) -> "OpcUaServerSecurity":
        if self.rejected == self.trusted:
            raise ValueError("rejected is the folder of trusted, so that everybody would be; expected another one")
        return self


class OpcUaPublisher(Model):
    """OPC-UA server with every published tag."""

    type: Literal["opcua"]
    host: Host = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all."""
    port: Annotated[int, Field(ge=1, le=65535)] = 4840
    """TCP port."""
    interval_ms: Annotated[float, Field(ge=5, le=60_000)] | None = None
    """How often new values are taken over, ms; the fastest task's period when left out."""
    users: tuple[OpcUaServerUser, ...] = ()
    """Who may write the writable tags; without any, everybody only reads."""
    security: OpcUaServerSecurity | None = None
    """Signing and encryption; leave it out for SecurityPolicy None alone."""

    def build(self, reader: Reader) -> Publisher:
        """The server; imports asyncua now."""
        from softplc.publishers.opcua.server import OpcUaServer  # noqa: PLC0415  asyncua takes seconds to import

        return OpcUaServer(self, reader)
