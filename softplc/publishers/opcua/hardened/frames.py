"""What the first bytes of a frame say, before anything is kept (OPC 10000-6, 6.7.2 and 7.1.2)."""

import struct
from typing import Final

from asyncua import ua

HEADER_BYTES: Final = 8
_HEADER: Final = struct.Struct("<3scI")
_CHANNEL_HEADER: Final = 12  # bytes of the header with the channel id
_BUFFERS: Final = struct.Struct("<III")  # how a Hello begins: version, receive and send buffer
_SMALLEST_BUFFER: Final = 8192
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


def is_hello_that_cannot_be(frame: bytes) -> bool:
    """A Hello with smaller buffers than OPC 10000-6, 7.1.2.3 allows: every answer would be cut into crumbs."""
    if frame[:3] != ua.MessageType.Hello:
        return False
    _, receive, send = _BUFFERS.unpack_from(frame.ljust(_HEADER.size + _BUFFERS.size, b"\0"), _HEADER.size)
    return bool(min(receive, send) < _SMALLEST_BUFFER)
