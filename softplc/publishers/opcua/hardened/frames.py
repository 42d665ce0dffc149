"""What the first bytes of a frame say, before anything is kept (OPC 10000-6, 6.7.2 and 7.1.2)."""

import struct
from typing import Final

from asyncua import ua

HEADER_BYTES: Final = 8
_HEADER: Final = struct.Struct("<3scI")
_CHANNEL_HEADER: Final = 12  # bytes of the header with the channel id
_HELLO: Final = struct.Struct("<IIIIIi")  # version, receive and send buffer, sizes of an answer, length of the URL
_SMALLEST_BUFFER: Final = 8192
_LONGEST_URL: Final = 4096  # bytes
_TYPES: Final = (
    ua.MessageType.SecureMessage,
    ua.MessageType.Hello,
    ua.MessageType.SecureOpen,
    ua.MessageType.SecureClose,
)


def frame_size(head: bytes | bytearray, chunk_bytes: int) -> int | None:
    """Bytes of the frame that begins with these eight, as its header declares; None when that cannot be."""
    kind, chunk, size = _HEADER.unpack_from(head)
    smallest = _HEADER.size if kind == ua.MessageType.Hello else _CHANNEL_HEADER
    if kind not in _TYPES or chunk not in b"FCA" or not smallest < size <= chunk_bytes:
        return None
    return int(size)


def hello_fault(frame: bytes) -> int:
    """Why this frame is a Hello that cannot be, as a status (OPC 10000-6, 7.1.2.3); 0 for any other.

    With smaller buffers than those there every answer would be cut into crumbs.
    """
    if frame[:3] != ua.MessageType.Hello:
        return 0
    _, receive, send, _, _, url = _HELLO.unpack_from(frame.ljust(_HEADER.size + _HELLO.size, b"\0"), _HEADER.size)
    if min(receive, send) < _SMALLEST_BUFFER:
        return int(ua.StatusCodes.BadConnectionRejected)
    return int(ua.StatusCodes.BadTcpEndpointUrlInvalid) if url > _LONGEST_URL else 0
