"""How large an answer a client takes."""

from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import MessageChunk, TransportLimits

_NO_LIMIT: Final = 1 << 31
_LEAST: Final = 8192  # bytes that everybody takes: the smallest buffer there is (OPC 10000-6, 7.1.2.3)


class ClientLimits(TransportLimits):  # type: ignore[misc]  # asyncua is untyped here
    """Limits of one connection, and those that the client named for what it is sent (OPC 10000-6, 7.1.2.3).

    asyncua: sends answers of any size, and takes what the client named as a limit for requests.
    """

    answer_bytes: int = 0  # 0: any number
    answer_chunks: int = 0

    def create_acknowledge_and_set_limits(self, msg: ua.Hello) -> Any:
        """Answer to Hello: what the server takes."""
        limits: Any = self
        own = limits.max_message_size, limits.max_chunk_count
        self.answer_bytes, self.answer_chunks = msg.MaxMessageSize, msg.MaxChunkCount
        acknowledge = super().create_acknowledge_and_set_limits(msg)
        limits.max_message_size, limits.max_chunk_count = own
        acknowledge.MaxMessageSize, acknowledge.MaxChunkCount = own
        return acknowledge

    def room(self, crypto: Any) -> int:
        """The most bytes that the plain body of an answer may have."""
        most = self.answer_bytes or _NO_LIMIT
        if self.answer_chunks:
            most = min(most, self.answer_chunks * MessageChunk.max_body_size(crypto, self.max_send_buffer))
        return max(int(most), _LEAST)
