"""A link that carries few bytes a second to whoever reads, as a phone with bad reception has."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading

_BUFFER_BYTES = 4096


class SlowLink:
    """Passes connections on to a port of this machine. port: where it listens. Use as a context manager."""

    def __init__(self, target, bytes_per_s):
        self._target, self._bytes_per_s = target, bytes_per_s
        self._thread = threading.Thread(target=lambda: asyncio.run(self._listen()))
        self._is_open = threading.Event()

    async def _listen(self):
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        self._one_by_one = asyncio.Lock()
        server = await asyncio.start_server(self._carry, "127.0.0.1", 0, limit=_BUFFER_BYTES)
        self.port = server.sockets[0].getsockname()[1]
        self._is_open.set()
        await self._end.wait()
        server.close()

    async def _carry(self, reader, writer):
        sock = socket.socket()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        sock.setblocking(False)
        await self._loop.sock_connect(sock, ("127.0.0.1", self._target))
        served, asking = await asyncio.open_connection(sock=sock, limit=_BUFFER_BYTES)
        ways = [
            asyncio.ensure_future(self._pass_on(reader, asking, 0.0)),
            asyncio.ensure_future(self._pass_on(served, writer, 1.0 / self._bytes_per_s)),
        ]
        with contextlib.suppress(asyncio.CancelledError):  # the end of the link
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in ways:
            way.cancel()
        for end in (writer, asking):
            end.transport.abort()

    async def _pass_on(self, reader, writer, s_per_byte):
        with contextlib.suppress(OSError):
            while part := await reader.read(1024):
                async with self._one_by_one:
                    await asyncio.sleep(s_per_byte * len(part))
                writer.write(part)
                await writer.drain()
            writer.write_eof()
            await asyncio.sleep(1.0)

    def __enter__(self):
        self._thread.start()
        assert self._is_open.wait(10)
        return self

    def __exit__(self, *_):
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()
