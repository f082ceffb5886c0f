"""An HTTP server for one page that nobody can make hold much: few connections at once, none for long."""

from __future__ import annotations

import threading
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

_CONNECTIONS = 8  #: at once; more are closed unanswered
_PATIENCE_S = 2.0  #: with a client that says nothing, or does not read


class _Handler(WSGIRequestHandler):
    timeout = _PATIENCE_S

    def log_message(self, *_: object) -> None:
        """Say nothing: what a client does wrong is its own affair."""


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True
    _places: threading.Semaphore

    def server_activate(self) -> None:
        self._places = threading.Semaphore(_CONNECTIONS)
        super().server_activate()

    def process_request(self, request: Any, client_address: Any) -> None:
        if self._places.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, *_: object) -> None:
        """Say nothing, as above."""


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
