"""An HTTP server for one page whose clients cannot hold it up: few connections at once, none for long."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from socketserver import ThreadingMixIn
from typing import Any, NamedTuple
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

_CONNECTIONS = 8  #: at once; the oldest one is closed for a new one
_DEADLINE_S = 2.0  #: of a connection as a whole, whatever arrives meanwhile
_PACE_S = 0.005  #: between two connections: a flood of them must not take the interpreter from the estimation


class _Handler(WSGIRequestHandler):
    timeout = _DEADLINE_S

    def log_message(self, *_: object) -> None:
        """Log nothing: a client's mistakes are no events of the daemon."""


class _Connection(NamedTuple):
    request: socket.socket
    thread: threading.Thread
    opened_s: float

    def cut(self) -> None:
        """End what is read from it and written to it; its thread then closes it."""
        with contextlib.suppress(OSError):  # closed already
            self.request.shutdown(socket.SHUT_RDWR)


class _Server(ThreadingMixIn, WSGIServer):
    """The connections are kept by the thread that accepts them alone, oldest first."""

    request_queue_size = 128
    _open: tuple[_Connection, ...] = ()

    def process_request(self, request: Any, client_address: Any) -> None:
        self.service_actions()
        if len(self._open) >= _CONNECTIONS:
            # a scrape takes milliseconds, so the oldest of many connections is a slow client
            self._open[0].cut()
            self._open[0].thread.join(_DEADLINE_S)
        thread = threading.Thread(
            target=self.process_request_thread, args=(request, client_address), daemon=True
        )
        thread.start()
        self._open = (*self._open, _Connection(request, thread, time.monotonic()))
        time.sleep(_PACE_S)

    def service_actions(self) -> None:
        """Close the connections whose time is over; called twice a second and with every new one."""
        self._open = tuple(c for c in self._open if c.thread.is_alive())
        for connection in self._open:
            if time.monotonic() - connection.opened_s > _DEADLINE_S:
                connection.cut()

    def server_close(self) -> None:
        super().server_close()
        for connection in self._open:
            connection.cut()

    def handle_error(self, *_: object) -> None:
        """Log nothing, as above."""


class HttpServer:
    """Serves a WSGI application on this machine, by a thread of its own. Errors: OSError."""

    def __init__(self, port: int, application: Any) -> None:
        self._server = make_server("127.0.0.1", port, application, _Server, _Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, name="canest-metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving and free the port; takes up to half a second."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
