"""A TCP relay on loopback that keeps what clients send."""

import asyncio
import contextlib


class Relay:
    """Listens on `port` and forwards to `target`; `streams` has what came on each connection.

    A connection that the target does not take is closed. `async with` ends it and everything that goes through it.
    """

    def __init__(self, target: int) -> None:
        self.target, self.port = target, 0
        self.streams: list[bytearray] = []
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> "Relay":
        self._server = await asyncio.start_server(self._connected, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        writers = [writer]
        try:
            with contextlib.suppress(OSError, asyncio.CancelledError):
                server_reader, server_writer = await asyncio.open_connection("127.0.0.1", self.target)
                writers.append(server_writer)
                self.streams.append(stream := bytearray())
                await asyncio.gather(_pump(reader, server_writer, stream), _pump(server_reader, writer, None))
        finally:
            for one in writers:
                one.transport.abort()


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, kept: bytearray | None) -> None:
    while data := await reader.read(65536):
        if kept is not None:
            kept += data
        writer.write(data)
    raise ConnectionError("this side has ended")
