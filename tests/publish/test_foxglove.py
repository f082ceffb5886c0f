"""`canest publish foxglove` as a process, and a client that speaks the Foxglove WebSocket protocol."""

from __future__ import annotations

import json
import socket
import struct
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from tests.serve.browser import BROWSER, Browser
from tests.serve.rig import Command, Stream, free_port, is_up, resident_mb, wait_for

client = pytest.importorskip("websockets.sync.client", reason="websockets (extra: foxglove)")
from websockets.exceptions import InvalidStatus  # noqa: E402


@pytest.fixture(scope="module")
def stream(tmp_path_factory):
    stream = Stream(tmp_path_factory.mktemp("stream"))
    yield stream
    stream.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory, stream):
    folder, port = tmp_path_factory.mktemp("server"), free_port()
    arguments = ("--socket", stream.status_socket, "--port", port)
    with Command(folder, "publish", "foxglove", *arguments) as process:
        assert wait_for(lambda: is_up(port), 20), process.output
        process.port = port
        yield process


def connect(port, path="/", subprotocol="foxglove.websocket.v1", **more):
    return client.connect(f"ws://127.0.0.1:{port}{path}", subprotocols=[subprotocol], open_timeout=5, **more)


def opening(viewer):
    """Return (serverInfo, channels by topic) that a new viewer gets."""
    info, advertised, status = (json.loads(viewer.recv(5)) for _ in range(3))
    assert (info["op"], advertised["op"], status["op"]) == ("serverInfo", "advertise", "status")
    return info, {channel["topic"]: channel for channel in advertised["channels"]}


def data(viewer, number=7):
    """Return (seconds, message) of the next binary message."""
    while True:
        received = viewer.recv(5)
        if isinstance(received, bytes):
            opcode, subscription, t_ns = struct.unpack_from("<BIQ", received)
            assert (opcode, subscription) == (1, number)
            return t_ns / 1e9, json.loads(received[13:])


def subscribe(viewer, channel, number=7):
    wanted = {"op": "subscribe", "subscriptions": [{"id": number, "channelId": channel["id"]}]}
    viewer.send(json.dumps(wanted))


@pytest.mark.parametrize("subprotocol", ["foxglove.websocket.v1", "foxglove.sdk.v1"])
def test_a_viewer_gets_the_estimates_that_it_has_subscribed_to(server, stream, subprotocol):
    jsonschema = pytest.importorskip("jsonschema")
    with connect(server.port, subprotocol=subprotocol) as viewer:
        assert viewer.subprotocol == subprotocol
        info, channels = opening(viewer)
        assert info["capabilities"] == []
        channel = channels["/canest/estimate"]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
        assert channel["schemaName"] == "canest.Estimate"
        subscribe(viewer, channel)
        for _ in range(3):
            t_s, message = data(viewer)
            jsonschema.Draft7Validator(json.loads(channel["schema"])).validate(message)
            assert abs(t_s - time.time()) < 60
            assert 20_000 <= message["mass_kg"] <= 20_006
            known = {"grade": 0.01, "speed_mps": 20.0, "gear": 9, "residual_N": 100, "mass_std_kg": 200.0}
            assert known.items() <= message.items()
            assert (message["status"], message["status_code"], message["gate"]) == ("valid", 2, "")
        viewer.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [7]}))
        subscribe(viewer, channels["/canest/status"], number=8)
        until_s = time.monotonic() + 5
        while time.monotonic() < until_s:
            received = viewer.recv(5)
            if isinstance(received, bytes) and struct.unpack_from("<BI", received)[1] == 8:
                assert json.loads(received[13:])["vehicle"] == "truck"
                return
    raise AssertionError("no status")


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("{", "this is no message of the protocol"),
        ("[]", "this is no message of the protocol"),
        ('{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 9}]}', "there is no channel 9"),
        ('{"op": "subscribe"}', "this is no message of the protocol"),
        ('{"op": "advertise", "channels": []}', "this server is read-only"),
    ],
)
def test_what_is_not_of_the_protocol_gets_a_sentence(server, text, answer):
    with connect(server.port) as viewer:
        opening(viewer)
        viewer.send(text)
        assert json.loads(viewer.recv(5))["message"].startswith(answer)


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        ("https://app.foxglove.dev", True),
        ("file://", True),
        ("http://localhost:8080", True),
        ("https://evil.example.org", False),
        ("http://localhost.evil.example.org", False),
        ("null", False),
    ],
)
def test_a_page_of_another_site_cannot_read_along(server, origin, allowed):
    if allowed:
        with connect(server.port, origin=origin) as viewer:
            opening(viewer)
        return
    with pytest.raises(InvalidStatus, match="403"):
        connect(server.port, origin=origin)


def test_a_name_that_another_site_points_at_us_is_refused(server):
    head = (
        "GET / HTTP/1.1\r\nHost: evil.example.org\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", server.port), 5) as raw:
        raw.sendall(head.encode())
        assert raw.recv(100).startswith(b"HTTP/1.1 403")


def test_with_a_token_only_who_knows_it_connects(tmp_path, stream):
    port, token = free_port(), "0123456789abcdef"
    (tmp_path / "token").write_text(token + "\n")
    arguments = ("--socket", stream.status_socket, "--port", port, "--token-file", tmp_path / "token")
    with Command(tmp_path, "publish", "foxglove", *arguments) as process:
        assert wait_for(lambda: is_up(port), 20), process.output
        for path in ("/", "/?token=wrong-wrong-wrong"):
            with pytest.raises(InvalidStatus, match="401"):
                connect(port, path)
        with connect(port, f"/?token={token}", origin="https://lichtblick.example.org") as viewer:
            opening(viewer)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_foxgloves_own_client_in_a_browser_reads_what_the_daemon_has_sent(server, stream, tmp_path):
    with Browser(tmp_path) as browser, BlankSite() as site:
        tab = browser.page(
            f"http://127.0.0.1:{site.server_port}/"
        )  # a page has an origin; about:blank has none
        tab.wait("true")
        tab.run(CLIENT.read_text() + "; window.FoxgloveProtocol = FoxgloveProtocol;")
        tab.run(READ % server.port)
        tab.wait("window.got.messages.length >= 5 && window.got.statuses.length >= 1")
        got = tab.run("window.got")
    assert got["errors"] == []
    assert got["info"]["name"].startswith("canest ")
    assert {channel["topic"] for channel in got["channels"]} == {"/canest/estimate", "/canest/status"}
    assert got["statuses"][0]["message"].startswith("following the daemon")
    times = [message["ns"] / 1e9 for message in got["messages"]]
    assert all(abs(t_s - time.time()) < 60 for t_s in times) and times == sorted(times)
    for message in got["messages"]:
        content = json.loads(message["text"])
        assert 20_000 <= content["mass_kg"] <= 20_006
        known = {"grade": 0.01, "grade_std": 0.001, "mass_std_kg": 200.0, "status": "valid"}
        assert known.items() <= content.items()


class BlankSite(ThreadingHTTPServer):
    """A site with one empty page. Use as a context manager."""

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Blank)

    def __enter__(self):
        threading.Thread(target=self.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.shutdown()
        self.server_close()


class _Blank(BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!doctype html><title>blank</title>")

    def log_message(self, *_):
        pass


CLIENT = Path(__file__).with_name("foxglove-client.min.js")
READ = """
    (() => {
      const { FoxgloveClient } = window.FoxgloveProtocol;
      const got = window.got = { errors: [], info: null, channels: [], messages: [], statuses: [] };
      const client = new FoxgloveClient({
        ws: new WebSocket("ws://127.0.0.1:%d/", [FoxgloveClient.SUPPORTED_SUBPROTOCOL]),
      });
      client.on("error", (error) => got.errors.push(String(error)));
      client.on("serverInfo", (info) => { got.info = info; });
      client.on("status", (status) => got.statuses.push(status));
      client.on("advertise", (channels) => {
        got.channels.push(...channels);
        for (const { id, topic } of channels) if (topic === "/canest/estimate") client.subscribe(id);
      });
      client.on("message", (message) => got.messages.push(
        { ns: Number(message.timestamp), text: new TextDecoder().decode(message.data) }));
    })()
"""


def test_a_viewer_that_reads_nothing_holds_up_neither_the_others_nor_the_daemon(server, stream):
    before_mb = resident_mb(server.process.pid)
    with connect(server.port, max_queue=1, close_timeout=0.1) as stuck, connect(server.port) as viewer:
        subscribe(stuck, opening(stuck)[1]["/canest/status"])  # 10 kB each
        subscribe(viewer, opening(viewer)[1]["/canest/estimate"])
        stream.pause_s, sent = 0.0005, stream.sent
        try:
            while stream.sent < sent + 1500:
                data(viewer)
        finally:
            stream.pause_s = 0.1
        assert stream.live.watched
        assert resident_mb(server.process.pid) - before_mb < 5
        assert data(viewer)
