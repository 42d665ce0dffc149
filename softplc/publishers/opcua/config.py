"""Configuration of the OPC-UA server."""

from typing import Annotated, Literal

from pydantic import Field

from softplc.exchange import Reader
from softplc.interfaces import Publisher
from softplc.model import Host, Model, Secret


class OpcUaServerUser(Model):
    """Someone who may write the writable tags after logging in; everybody else only reads."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    """User name."""
    password: Secret
    """Where the password is to be found."""


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

    def build(self, reader: Reader) -> Publisher:
        """The server; imports asyncua now."""
        from softplc.publishers.opcua.server import OpcUaServer  # noqa: PLC0415  asyncua takes seconds to import

        return OpcUaServer(self, reader)
