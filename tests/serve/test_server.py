"""The server as a process: what it answers, what it refuses, and what bad clients cost."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import sys
import time
from pathlib import Path

import pytest

from canest.serve.hub import MOST_PAGES
from canest.telemetry.live_protocol import COLUMNS, stream_path
from tests.serve.rig import (
    Command,
    EventReader,
    Stream,
    free_port,
    get,
    history,
    is_up,
    resident_mb,
    served,
    wait_for,
)  # fmt: skip

PAGE = Path(sys.modules["canest"].__file__).parent / "serve" / "page"


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A page server that tests share, since they leave it as it was."""
    folder = tmp_path_factory.mktemp("shared")
    stream = Stream(folder)
    with served(folder, stream) as process:
        yield process
    stream.close()


def test_a_page_that_opens_gets_what_was_before_and_then_what_comes(server, stream):
    before = history(server.port)
    assert before["columns"] == list(COLUMNS) and before["status"]["vehicle"] == "truck"
    assert before["problem"] == "" and before["gates"]["6"] == "shift"
    assert len(before["day"][0]) == len(before["day_columns"])
    with EventReader(server.port) as page:
        assert page.read(b"event: rows\ndata: ") and page.read(b"event: status\ndata: ")
        head = page.received.split(b"\r\n\r\n")[0]
    assert b"text/event-stream" in head and b"Content-Length" not in head


@pytest.mark.parametrize("path", ["/", "/live.js", "/history", "/nothing", "/events"])
def test_every_answer_forbids_what_the_page_does_not_need(shared, path):
    with socket.create_connection(("127.0.0.1", shared.port), 5) as client:
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        head = client.recv(4096).decode("latin-1").split("\r\n\r\n")[0]
    policy = re.search("Content-Security-Policy: (.*)", head)[1]
    assert "default-src 'none'" in policy and "unsafe" not in policy and "*" not in policy
    assert "X-Content-Type-Options: nosniff" in head


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_the_page_is_read_only(shared, method):
    assert get(shared.port, "/", method)[0] == 405


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/%2e%2e/server.py", "//etc/passwd", "/page/live.js"])
def test_nothing_but_the_page_can_be_read(shared, path):
    with socket.create_connection(("127.0.0.1", shared.port), 5) as client:
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert client.recv(100).startswith(b"HTTP/1.1 404")


@pytest.mark.parametrize(
    "junk",
    [
        b"\r\n\r\n",
        b"GET\r\n\r\n",
        b"\x00" * 20_000,
        b"GET / SPDY/9\r\n\r\n",
        b"GET http://a/ HTTP/1.1\r\n\r\n",
    ],
)
def test_what_is_no_request_is_refused_and_the_next_one_is_answered(shared, junk):
    with socket.create_connection(("127.0.0.1", shared.port), 5) as client:
        client.sendall(junk)
        with contextlib.suppress(ConnectionResetError):
            assert client.recv(100).startswith(b"HTTP/1.1 400")
    assert get(shared.port)[0] == 200
    assert "Traceback" not in shared.output


def test_a_foreign_name_for_this_machine_is_refused(shared):
    assert get(shared.port, "/history", Host="evil.example")[0] == 403


def test_the_page_is_small_and_names_no_other_server():
    files = [path for path in PAGE.iterdir() if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 300_000
    for path in files:
        if path.suffix in (".html", ".css", ".js") and "uPlot" not in path.name:
            text = path.read_text().replace("http://www.w3.org/2000/svg", "")
            assert not re.search(r"https?://|//[a-z]+\.[a-z]", text), path
            assert not re.search(r"\son\w+=|\sstyle=|javascript:", text) or path.suffix == ".js"
    assert "v1.6.32" in (PAGE / "uPlot.iife.min.js").read_text()[:200]
    assert "Leon Sorokin" in (PAGE / "uPlot.LICENSE.txt").read_text()


def test_a_page_that_does_not_read_costs_no_memory_and_others_miss_nothing(server, stream):
    with contextlib.ExitStack() as stack:
        for _ in range(5):
            stack.enter_context(EventReader(server.port))  # these read nothing
        reader = stack.enter_context(EventReader(server.port))
        assert reader.read(b"event: rows")
        before_mb = resident_mb(server.process.pid)
        stream.pause_s = 0.002  # hundreds of times as fast as a daemon
        begin, reader.received = stream.sent, b""
        end_s = time.monotonic() + 8
        count = 0
        while time.monotonic() < end_s:
            part = reader.socket.recv(1 << 20)
            count += part.count(b"event: rows")
        assert stream.sent - begin > 500
        assert count > 0.8 * (stream.sent - begin)
        assert resident_mb(server.process.pid) - before_mb < 20
    assert get(server.port)[0] == 200


def test_pages_beyond_the_limit_are_refused_in_a_sentence(server):
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_PAGES):
            assert stack.enter_context(EventReader(server.port)).read(b"retry:")
        code, _, text = get(server.port, "/events")
        assert code == 503 and b"16 pages are open already" in text
    assert wait_for(lambda: opens(server.port))


def opens(port):
    with contextlib.suppress(OSError), EventReader(port) as page:
        return page.read(b"retry:", 2)
    return False


def test_connections_that_send_nothing_hold_nobody_up_for_long(server):
    with contextlib.ExitStack() as idle:
        for _ in range(100):
            idle.enter_context(socket.create_connection(("127.0.0.1", server.port), 5))
        assert wait_for(lambda: answered(server.port), 10)


def answered(port):
    with contextlib.suppress(OSError):
        return get(port)[0] == 200
    return False


def test_a_daemon_that_goes_and_comes_back_is_followed(server, stream, tmp_path):
    with EventReader(server.port) as page:
        stream.close()
        assert page.read(b"the daemon has ended")
        assert history(server.port)["recent"], "what was received stays"
        page.received = b""
        again = Stream(tmp_path)
        try:
            assert page.read(b"event: rows")
            assert history(server.port)["problem"] == ""
        finally:
            again.close()


def test_a_daemon_that_sends_rubbish_is_left_and_tried_again(tmp_path):
    path, port = stream_path(tmp_path / "status-can0.sock"), free_port()
    with socket.socket(socket.AF_UNIX) as daemon:
        daemon.bind(str(path))
        daemon.listen()
        with Command(tmp_path, "serve", "--socket", tmp_path / "status-can0.sock", "--port", port) as process:
            for rubbish in (b"rubbish\n", b"[1]\n", b'{"rows": 1}\n', b'{"columns": 7}\n', b"x" * (1 << 21)):
                client, _ = daemon.accept()
                with client, contextlib.suppress(OSError):
                    client.settimeout(5)
                    client.sendall(rubbish)
                    assert client.recv(1) == b""
            assert answered(port) and history(port)["problem"]
            assert process.process.poll() is None and "Traceback" not in process.output


def test_a_taken_port_is_refused_in_one_line(tmp_path):
    with socket.socket() as occupied:
        occupied.bind(("127.0.0.1", 0))
        occupied.listen()
        port = occupied.getsockname()[1]
        with Command(tmp_path, "serve", "--socket", tmp_path / "status-can0.sock", "--port", port) as process:
            assert process.process.wait(20) == 1
            assert process.output == f"error: 127.0.0.1:{port}: the port is taken, expected another --port\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--address", "0.0.0.0"], "everybody in the network could read the page, expected --token-file"),
        (["--address", "truck"], "is no address, found 'truck', expected an IP address"),
        (["--token-file", "short"], "cannot serve as a token, found 5 characters"),
        (["-c", "class8"], "found no daemon to follow, expected -c CONFIG (or --socket PATH)"),
    ],
)
def test_a_wrong_use_is_one_line_and_exit_2(tmp_path, arguments, message):
    (tmp_path / "short").write_text("12345\n")
    with Command(
        tmp_path, "serve", "--socket", "status-can0.sock", "--port", free_port(), *arguments
    ) as process:
        assert process.process.wait(20) == 2
        assert message in process.output and process.output.count("\n") == 1


def test_with_a_token_only_who_knows_it_gets_the_page(tmp_path, stream):
    token, port = "0123456789abcdef", free_port()
    (tmp_path / "token").write_text(f"{token}\n")
    options = ["--address", "0.0.0.0", "--token-file", tmp_path / "token", "--port", port]
    with Command(tmp_path, "serve", "--socket", stream.status_socket, *options):
        assert wait_for(lambda: is_up(port), 20)
        assert [get(port, path)[0] for path in ("/", "/history", "/events", "/live.js")] == [401] * 4
        code, headers, _ = get(port, f"/?token={token}")
        assert code == 303
        cookie = headers["Set-Cookie"].split(";")[0]
        assert get(port, "/", Cookie=cookie, Host="truck:8080")[0] == 200


def test_a_signal_ends_it_at_once(server):
    with EventReader(server.port) as page:
        assert page.read(b"retry:")
        begin_s = time.monotonic()
        assert server.end(signal.SIGTERM) == 0
        assert time.monotonic() - begin_s < 5


def test_the_server_loads_neither_the_bus_nor_the_databases():
    code = "import sys, canest.cli.serve, canest.serve.server, canest.serve.daemon_source\n"
    heavy = "('can', 'cantools', 'pydantic', 'numba', 'plotly', 'jinja2', 'scipy')"
    code += f"assert not [name for name in {heavy} if name in sys.modules], list(sys.modules)"
    assert os.spawnv(os.P_WAIT, sys.executable, [sys.executable, "-c", code]) == 0


def test_a_daemon_that_starts_later_in_another_place_is_found(tmp_path, monkeypatch):
    from canest.cli.live_source import status_socket
    from canest.config import load_config

    config = load_config("vcan", [f"service.state_dir={tmp_path}"], databases=False)
    elsewhere = tmp_path / "run" / "status-vcan0.sock"
    found = []
    monkeypatch.setattr("canest.telemetry.status_socket.find_sockets", lambda: iter(found))
    assert status_socket(config, None) == tmp_path / "status-vcan0.sock"
    found.append(elsewhere)
    assert status_socket(config, None) == elsewhere
