"""Who may do what: everybody reads, a configured user writes the writable tags, nobody does anything else.

A write does not touch the published value. It goes to the scan process as a command, which applies it in its next
scan and publishes the tag; so what clients read is always what the observer uses.
"""

import hashlib
import hmac
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole

from softplc.exchange import Reader
from softplc.publishers.opcua.config import OpcUaServerUser
from softplc.publishers.opcua.values import VARIANT_TYPES, TagValues
from softplc.tags import Tag

_TOLD_EVERY: Final = 60.0  # seconds between two log lines about log-ins of one user, and about refused ones

log = structlog.get_logger(__name__)


class Users:
    """The configured users, in the form that asyncua asks.

    Reads every password at construction; raises ConfigError where one is not to be had. Comparing takes the same
    time for every name and password, known or not.
    """

    def __init__(self, users: Sequence[OpcUaServerUser]) -> None:
        self._digests = [_digest(user.name, user.password.read()) for user in users]

    def get_user(
        self, _server: Any, username: str | None = None, password: str | None = None, **_certificate: Any
    ) -> Any:
        """The session's user; nobody is an administrator. Raises ServiceError BadIdentityTokenRejected.

        A certificate that the client has sent for its channel says nothing without a secured channel.
        """
        if username is None and password is None:
            return User(UserRole.Anonymous)
        offered = _digest(username or "", password or "")
        known = False
        for digest in self._digests:
            known |= hmac.compare_digest(digest, offered)
        if not known:
            raise ServiceError(ua.StatusCodes.BadIdentityTokenRejected)
        return User(UserRole.User, username)


def _digest(name: str, password: str) -> bytes:
    name_bytes, password_bytes = (text.encode(errors="surrogateescape") for text in (name, password))
    return hashlib.sha256(len(name_bytes).to_bytes(4, "big") + name_bytes + password_bytes).digest()


class AllServices(PermissionRuleset):  # type: ignore[misc]  # asyncua is untyped here
    """Which services exist at all is decided in `hardened.services`; of those, every user may use each."""

    def check_validity(self, _user: Any, _service: Any, _body: Any) -> bool:
        """Yes."""
        return True


class Access:
    """Decides on every write and hands the good ones to the scan process."""

    def __init__(self, reader: Reader, values: TagValues, index: Mapping[Any, int]) -> None:
        self._reader, self._values, self._index = reader, values, index
        self._refused = 0
        self._told = -math.inf
        self._logged_in: dict[tuple[str, str], float] = {}

    def may_write(self, user: Any, node_id: Any) -> bool:
        """This user may write this node's value."""
        index = self._index.get(node_id)
        return index is not None and self._reader.table.tags[index].writable and user.role is UserRole.User

    def write(self, user: Any, item: Any) -> int:
        """Status of one WriteValue from a client; a Good one is on its way to the scan process.

        `item` names a node and attribute that exist. Timestamps that come with the value are ignored.
        """
        codes = ua.StatusCodes
        index = self._index.get(item.NodeId)
        if index is None or item.AttributeId != ua.AttributeIds.Value:
            return int(codes.BadNotWritable)
        tag = self._reader.table.tags[index]
        if not tag.writable:
            return int(codes.BadNotWritable)
        if not self.may_write(user, item.NodeId):
            return int(codes.BadUserAccessDenied)
        if item.IndexRange or (item.Value.StatusCode is not None and item.Value.StatusCode.value):
            return int(codes.BadWriteNotSupported)
        status = _judge(tag, item.Value.Value)
        if status:
            return status
        return self._command(user, tag, index, float(item.Value.Value.Value))

    def logged_in(self, user: str, address: str) -> None:
        """A log-in; told at most once a minute for the same user at the same address."""
        now = self._reader.clock.monotonic()
        recent = {who: told for who, told in self._logged_in.items() if now - told < _TOLD_EVERY}
        if (user, address) not in recent:
            log.info("opcua log-in", user=user, address=address)
            recent[user, address] = now
        self._logged_in = recent

    def refused(self, address: str) -> None:
        """A log-in was refused; told at most once a minute, with the number of those in between."""
        self._refused += 1
        now = self._reader.clock.monotonic()
        if now - self._told >= _TOLD_EVERY:
            log.warning("opcua log-in refused", address=address, count=self._refused)
            self._told, self._refused = now, 0

    def _command(self, user: Any, tag: Tag, index: int, value: float) -> int:
        if not self._values.alive(index):
            return int(ua.StatusCodes.BadNoCommunication)
        if not self._reader.command(index, value):
            return int(ua.StatusCodes.BadResourceUnavailable)
        if value != self._values.values[index]:
            log.info("opcua write", user=user.name, tag=tag.name, value=value)
        return int(ua.StatusCodes.GoodCompletesAsynchronously)


def _judge(tag: Tag, variant: Any) -> int:
    """0 when the variant is a value that the tag can take, else the status that says why not."""
    if variant is None or variant.is_array or variant.VariantType != VARIANT_TYPES[tag.data_type]:
        return int(ua.StatusCodes.BadTypeMismatch)
    value = float(variant.Value)
    if not math.isfinite(value):
        return int(ua.StatusCodes.BadOutOfRange)
    limits = tag.limits or tag.range
    if limits is not None and not limits[0] <= value <= limits[1]:
        return int(ua.StatusCodes.BadOutOfRange)
    return 0
