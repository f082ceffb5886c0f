"""The metrics port, and clients that mean no good."""

from __future__ import annotations

import contextlib
import socket
import threading
import urllib.request

import pytest

from canest.telemetry.metrics import MetricsServer
from tests.live.rig import free_port, wait_for


def answers(port):
    with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as got:
        return got.status == 200
    return False


def test_who_connects_and_says_nothing_holds_neither_threads_nor_others_up(capfd):
    pytest.importorskip("prometheus_client")
    server, before = MetricsServer(free_port(), {}), threading.active_count()
    with contextlib.ExitStack() as idle:
        for _ in range(90):
            idle.enter_context(socket.create_connection(("127.0.0.1", server.port), 5))
        assert threading.active_count() - before <= 8
        assert wait_for(lambda: answers(server.port))
    server.close()
    assert capfd.readouterr().err == ""
