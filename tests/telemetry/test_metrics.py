"""The metrics port, and clients that mean no good."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
import urllib.request

import pytest

from canest.telemetry.metrics import MetricsServer
from tests.live.rig import free_port, wait_for

REQUEST = b"GET /metrics HTTP/1.1\r\n" + b"X-Filler: 0123456789\r\n" * 90


@pytest.fixture
def server():
    pytest.importorskip("prometheus_client")
    server = MetricsServer(free_port(), {})
    yield server
    server.close()


class Tricklers:
    """Clients that send a byte of a request each every 0.2 s, and connect again when they are closed."""

    def __init__(self, port, clients):
        self._port, self._ended = port, threading.Event()
        self.closed = 0
        self._threads = [threading.Thread(target=self._trickle) for _ in range(clients)]

    def _trickle(self):
        while not self._ended.is_set():
            with (
                contextlib.suppress(OSError),
                socket.create_connection(("127.0.0.1", self._port), 5) as client,
            ):
                for byte in REQUEST:
                    client.send(bytes([byte]))
                    if self._ended.wait(0.2):
                        return
            self.closed += 1

    def __enter__(self):
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        for thread in self._threads:
            thread.join()


def answers(port):
    with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as got:
        return got.status == 200
    return False


def test_a_silent_client_holds_neither_threads_nor_others_up(capfd):
    pytest.importorskip("prometheus_client")
    server, before = MetricsServer(free_port(), {}), threading.active_count()
    with contextlib.ExitStack() as idle:
        for _ in range(90):
            idle.enter_context(socket.create_connection(("127.0.0.1", server.port), 5))
        assert threading.active_count() - before <= 8
        assert wait_for(lambda: answers(server.port))
    server.close()
    assert capfd.readouterr().err == ""


def test_eight_clients_that_trickle_bytes_do_not_lock_scrapes_out(server, capfd):
    with Tricklers(server.port, 8) as tricklers:
        time.sleep(1.0)
        assert all(answers(server.port) for _ in range(10))
        assert wait_for(lambda: tricklers.closed >= 8, 10)
        assert answers(server.port)
    assert capfd.readouterr().err == ""


def test_a_client_that_trickles_bytes_is_closed_after_a_few_seconds(server):
    with Tricklers(server.port, 1) as tricklers:
        assert wait_for(lambda: tricklers.closed == 1, 10)


def test_a_server_that_closes_lets_go_of_its_clients():
    pytest.importorskip("prometheus_client")
    before = threading.active_count()
    server = MetricsServer(free_port(), {})
    with socket.create_connection(("127.0.0.1", server.port), 5) as client:
        client.sendall(b"GET")
        assert wait_for(lambda: threading.active_count() == before + 2)
        server.close()
        assert wait_for(lambda: threading.active_count() == before, 1.0)
