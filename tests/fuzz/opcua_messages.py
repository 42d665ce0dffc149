"""OPC-UA messages as recorded from real clients, and as frames of another connection and session.

A corpus file has one frame per line: `service hex`. Session token, subscription and what else differs from one
session to the next are placeholders in it.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary

CORPUS = Path(__file__).parent / "corpus" / "opcua"
TOKEN = b"\xee" * 32
SUBSCRIPTION = struct.pack("<I", 0xEEEEEE01)
_HEAD = 8
_CHANNEL = struct.Struct("<IIII")  # channel, token, sequence number, request id

_SERVICES = {
    value: name.removesuffix("_Encoding_DefaultBinary")
    for name, value in vars(ua.ObjectIds).items()
    if name.endswith("Request_Encoding_DefaultBinary")
}
TYPE_IDS = sorted(_SERVICES)


@dataclass(frozen=True)
class Message:
    """A recorded request. `body` begins with its type; `payload` is where its request header ends."""

    service: str
    kind: bytes  # HEL, OPN, MSG, CLO
    body: bytes
    payload: int = 0


def frames(stream: bytes) -> Iterator[bytes]:
    """Cut a client's stream into its frames."""
    while stream:
        size = struct.unpack_from("<I", stream, 4)[0]
        yield stream[:size]
        stream = stream[size:]


def parse(frame: bytes) -> Message:
    """A frame as a message; Hello and OpenSecureChannel keep everything behind the eight bytes of the header."""
    kind = frame[:3]
    if kind != b"MSG":
        return Message({b"HEL": "Hello", b"OPN": "OpenSecureChannel", b"CLO": "CloseSecureChannel"}[kind], kind,
                       frame[_HEAD:])  # fmt: skip
    body = frame[_HEAD + _CHANNEL.size :]
    rest = Buffer(body)
    type_id = nodeid_from_binary(rest)
    struct_from_binary(ua.RequestHeader, rest)
    return Message(_SERVICES[type_id.Identifier], kind, body, len(body) - len(rest))


def corpus() -> list[Message]:
    """Every recorded message."""
    return [parse(bytes.fromhex(line.split()[1])) for path in sorted(CORPUS.glob("*.txt"))
            for line in path.read_text().splitlines()]  # fmt: skip


def frame(kind: bytes, content: bytes, chunk: bytes = b"F") -> bytes:
    """A frame of this kind."""
    return kind + chunk + struct.pack("<I", _HEAD + len(content)) + content


@dataclass
class Channel:
    """Numbers of one connection; what the server gave, and what counts on."""

    channel: int = 0
    token: int = 0
    session: bytes = TOKEN
    subscription: bytes = SUBSCRIPTION
    sequence: int = 0
    request: int = 0

    def fill(self, body: bytes) -> bytes:
        """The body with this session's own token and subscription."""
        return body.replace(TOKEN, self.session).replace(SUBSCRIPTION, self.subscription)

    def message(self, body: bytes, kind: bytes = b"MSG", cuts: tuple[int, ...] = ()) -> bytes:
        """Frames of a request, in chunks that end at `cuts`."""
        self.request += 1
        made, edges = b"", [0, *sorted(cuts), len(body)]
        for number in range(len(edges) - 1):
            self.sequence += 1
            head = _CHANNEL.pack(self.channel, self.token, self.sequence, self.request)
            last = number == len(edges) - 2
            made += frame(kind, head + body[edges[number] : edges[number + 1]], b"F" if last else b"C")
        return made

    def opening(self, recorded: bytes) -> bytes:
        """A recorded OpenSecureChannel frame's content, with this connection's sequence."""
        at = _behind_security(recorded)
        self.sequence += 1
        self.request += 1
        return recorded[:at] + struct.pack("<II", self.sequence, self.request) + recorded[at + 8 :]

    def opened(self, answer: bytes) -> None:
        """Take channel and token from the content of an OpenSecureChannel answer."""
        found = struct_from_binary(ua.OpenSecureChannelResponse, Buffer(answer[_behind_security(answer) + 8 :]))
        self.channel = found.Parameters.SecurityToken.ChannelId
        self.token = found.Parameters.SecurityToken.TokenId


def _behind_security(content: bytes) -> int:
    """Where channel id, policy, certificate and thumbprint end."""
    at = 4
    for _ in range(3):
        at += 4 + max(int.from_bytes(content[at : at + 4], "little", signed=True), 0)
    return at
