"""The status socket where others crowd it, and daemons that answer badly."""

from __future__ import annotations

import contextlib
import io
import json
import os
import socket
import threading
import time

import pytest

from canest.system.files import Background
from canest.system.journal import Journal
from canest.telemetry.endpoints import Endpoints
from canest.telemetry.status_socket import StatusServer, published_path, read_status
from tests.live.rig import config, wait_for


@pytest.fixture
def crowd():
    """A function that connects to a socket until there is no room for one more."""
    with contextlib.ExitStack() as waiting:

        def fill(path):
            with contextlib.suppress(BlockingIOError):
                while True:
                    client = waiting.enter_context(socket.socket(socket.AF_UNIX))
                    client.setblocking(False)
                    client.connect(str(path))

        yield fill


def test_a_queue_that_somebody_keeps_full_locks_nobody_out(tmp_path, crowd):
    background = Background()
    endpoints = Endpoints(config(tmp_path), Journal(io.StringIO()), background)
    crowd(endpoints.status.path)
    endpoints.status.poll(lambda: {"pid": 7})
    crowd(endpoints.status.path)
    assert wait_for(published_path(endpoints.status.path).exists)
    assert read_status(endpoints.status.path) == {"pid": 7}
    assert published_path(endpoints.status.path).stat().st_mode & 0o777 == 0o644
    background.close(1.0)
    endpoints.close()
    assert not list(tmp_path.glob("status-*"))


def test_who_is_not_crowded_publishes_nothing(tmp_path):
    published = []
    server = StatusServer(tmp_path / "status-can0.sock", published.append)
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(server.path))
        server.poll(lambda: {"pid": 7})
        assert json.loads(client.recv(100)) == {"pid": 7}
    server.close()
    assert not published


def test_an_answer_published_long_ago_is_not_taken_for_one_of_now(tmp_path, crowd):
    server = StatusServer(tmp_path / "status-can0.sock")
    crowd(server.path)
    published_path(server.path).write_text("{}")
    os.utime(published_path(server.path), (time.time() - 60, time.time() - 60))
    with pytest.raises(BlockingIOError):
        read_status(server.path)
    server.close()


@pytest.mark.parametrize(
    ("part", "every_s", "error"),
    [(b" ", 0.2, TimeoutError), (b" " * (1 << 20), 0.0, ValueError)],
    ids=["trickled", "endless"],
)
def test_an_answer_that_never_ends_is_not_waited_for(tmp_path, part, every_s, error):
    path, ended = tmp_path / "status-can0.sock", threading.Event()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()

        def answer():
            client, _ = server.accept()
            with client, contextlib.suppress(OSError):
                while not ended.wait(every_s):
                    client.send(part)

        thread = threading.Thread(target=answer)
        thread.start()
        begin_s = time.monotonic()
        with pytest.raises(error):
            read_status(path)
        assert time.monotonic() - begin_s < 10
        ended.set()
        thread.join()
