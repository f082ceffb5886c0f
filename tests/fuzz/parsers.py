"""One target for every single parser: each log format, DBC files, HTTP and status requests, slcan lines."""

from __future__ import annotations

import contextlib
import socket
from functools import cache, partial
from typing import Any

from canest.bus.pythoncan import PythonCanReceiver
from canest.config.bus import Bus
from canest.config.database_files import read_database
from canest.core.errors import CanestError
from canest.system.shipped_files import find
from canest.telemetry.metrics_http import HttpServer
from canest.telemetry.status_socket import StatusServer

from .targets import _NUMBERS, _TEXT, _YAML, SUFFIXES, Target, log_seeds, run_logs, scratch

#: log format -> its file name suffix
FORMATS = {"candump": ".log", "asc": ".asc", "blf": ".blf", "trc": ".trc", "csv": ".csv",
           "parquet": ".parquet", "db": ".db", "mf4": ".mf4", "gzip": ".log.gz", "xz": ".csv.xz"}  # fmt: skip
_WAIT_S = 1.0


def _run_format(index: int, data: bytes) -> None:
    run_logs(bytes([index]) + data)


def _format_seeds(index: int, screen_form: bool = False) -> list[bytes]:
    seeds = [seed[1:] for seed in log_seeds() if seed[0] == index]
    return [s for s in seeds if s.startswith(b" ") == screen_form] or [b"MDF     4.10    "]


def run_dbc(data: bytes) -> None:
    """Any text: one plain error, or a database with messages."""
    path = scratch() / "bus.dbc"
    path.write_bytes(data)
    try:
        assert read_database(path).messages
    except CanestError as error:
        assert "\n" not in str(error)


def dbc_seeds() -> list[bytes]:
    """Return the shipped database of our own messages, and the first messages of the large one."""
    large = find("dbc", "j1939.dbc").read_bytes()
    return [find("dbc", "canest.dbc").read_bytes(), large[: large.index(b"\nBO_ ", 6000) + 1]]


@cache
def _http() -> int:
    """Start the metrics server; return its port."""

    def page(environment: Any, start_response: Any) -> list[bytes]:
        start_response("200 OK", [("Content-Type", "text/plain")])
        return [b"canest_bus_up 1.0\n"]

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    HttpServer(port, page)
    return port


def _asked(port: int, request: bytes) -> bytes:
    answer = b""
    with socket.create_connection(("127.0.0.1", port), _WAIT_S) as client, contextlib.suppress(OSError):
        client.sendall(request)
        client.shutdown(socket.SHUT_WR)
        while part := client.recv(1 << 16):
            answer += part
    return answer


def run_metrics(data: bytes) -> None:
    """Any request to the metrics port: the next client is answered."""
    port = _http()
    _asked(port, data)
    assert b"canest_bus_up" in _asked(port, b"GET /metrics HTTP/1.0\r\n\r\n")


@cache
def _status() -> StatusServer:
    return StatusServer(scratch() / "status-fuzz.sock")


def run_status(data: bytes) -> None:
    """Whatever a client of the status socket sends, it and the next one are answered."""
    server = _status()
    for request in (data, b""):
        with (
            socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client,
            contextlib.suppress(BrokenPipeError),
        ):
            client.settimeout(_WAIT_S)
            client.connect(str(server.path))
            client.sendall(request[:4096])
            server.poll(lambda: {"status": "valid"})
            with contextlib.suppress(ConnectionResetError):  # what was sent was not read
                assert client.recv(100) == b'{"status": "valid"}'


def run_slcan(data: bytes) -> None:
    """Any bytes of a serial adapter: nothing is raised, and the adapter's other frames come through."""
    options = {"sleep_after_open": 0.0}
    receiver = PythonCanReceiver(Bus(interface="slcan", channel="loop://", options=options), [])
    try:
        bus: Any = receiver._bus
        bus.serialPortOrig.reset_input_buffer()  # the loop hands the adapter's own commands back
        bus.serialPortOrig.write(data[:2000])
        for _ in range(4):
            receiver.collect()
        frames = receiver.drain().frames
        assert len(frames) <= len(data)
    finally:
        receiver.close()


def parser_targets() -> list[Target]:
    """Return the targets; a name holds no hyphen, since the files of what was found begin with it."""
    targets = [
        Target(name, partial(_run_format, i), partial(_format_seeds, i), [*_NUMBERS, *_TEXT])
        for name, suffix in FORMATS.items()
        for i in [SUFFIXES.index(suffix)]
    ]
    words = [b"BO_ ", b"SG_ ", b"VAL_ ", b"@0+", b"@1-", b"|", b"BA_ ", b"BA_DEF_ ", b"m0", b"Vector__XXX"]
    requests = [
        b"GET / HTTP/1.1\r\nHost: a\r\n\r\n",
        b"POST /metrics HTTP/1.0\r\nContent-Length: 5\r\n\r\nabcde",
    ]
    lines = [b"T0CF0040080102030405060708\r", b"t1232AABB\rr1230\r", b"D18FEF1000801020304050607081122\r\x07"]
    return [
        *targets,
        Target("screen", partial(_run_format, 0), partial(_format_seeds, 0, True), [*_NUMBERS, *_TEXT]),
        Target("dbc", run_dbc, dbc_seeds, [*_NUMBERS, *words]),
        Target(
            "metrics",
            run_metrics,
            lambda: requests,
            [b"\r\n", b"HTTP/9.9", b"Content-Length: -1", *_YAML[:4]],
        ),
        Target("status", run_status, lambda: [b"GET / HTTP/1.0\r\n\r\n", b"{}"]),
        Target("slcan", run_slcan, lambda: lines, [b"\r", b"\x07", b"T", b"d", b"\xff"]),
    ]
