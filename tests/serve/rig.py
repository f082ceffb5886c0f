"""A daemon, its bus and its page as processes of their own, as a user starts them."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

from canest.demo import DRIVE
from canest.telemetry.live_protocol import COLUMNS, stream_path
from canest.telemetry.live_stream import LiveStream
from tests.live.rig import free_port, wait_for

ROOT = Path(__file__).resolve().parents[2]
PORTS = {"own": 43231}


class Command:
    """`canest ...` in the background; its output in a file. Use as a context manager."""

    def __init__(self, folder, *arguments):
        self._log = folder / f"{arguments[0]}-{time.monotonic_ns()}.log"
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "canest", *map(str, arguments)],
                env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
                stdout=log, stderr=log, stdin=subprocess.DEVNULL, cwd=folder,
            )  # fmt: skip

    @property
    def output(self):
        return self._log.read_text()

    def send(self, number):
        self.process.send_signal(number)

    def end(self, number=signal.SIGTERM):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGCONT)
            self.process.send_signal(number)
        return self.process.wait(10)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.end()
        self.process.kill()
        self.process.wait()


STATUS = {"vehicle": "truck", "bus": {"state": "up"}, "filler": "x" * 10_000}


class Stream:
    """A daemon's live stream that sends as a daemon does, or faster; no estimation behind it.

    columns: the order of a row's values. sends_rows: whether there are any.
    """

    def __init__(self, folder, columns=COLUMNS):
        self.columns, self.sends_rows = columns, True
        self.status_socket = folder / "status-can0.sock"
        self.live = LiveStream(stream_path(self.status_socket))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send)
        self.pause_s, self.sent = 0.1, 0
        self.mass_kg, self.status = 20_000.0, 2
        self._thread.start()

    def _send(self):
        t_s = time.time()
        while not self._ended.wait(self.pause_s):
            t_s = max(t_s + 0.1, time.time())  # a busy machine sends fewer rows, and not older ones
            mass_kg = self.mass_kg + self.sent % 7
            values = [round(t_s, 2), mass_kg, 200.0, 0.01, 0.001, self.status, 0, 20.0, 900.0, 9, 100]
            named = dict(zip(COLUMNS, values, strict=True))
            row = [named[name] for name in self.columns]
            self.live.poll(lambda: STATUS)
            if self.live.watched and self.sends_rows:
                self.live.send_rows([row], row, 0.0)
                self.sent += 1

    def close(self):
        self._ended.set()
        self._thread.join()
        self.live.close()


class Vehicle:
    """A bus of its own (multicast), a daemon on it, and a drive that can be played to it."""

    def __init__(self, folder, group):
        self.folder, self.group = folder, group
        self.status_socket = folder / f"status-udp_multicast-{group}.sock"
        self._changes = [
            "-c", "class8", "--set", "bus.interface=udp_multicast", "--set", f"bus.channel={group}",
            "--set", f"service.state_dir={folder}", "--set", "service.learn='off'",
            "--set", "broadcast.enabled=true",
        ]  # fmt: skip

    def daemon(self, *more):
        return Command(self.folder, "run", *self._changes, *more)

    def drive(self, times=1):
        """Play the bundled drive of three minutes, so many times in a row."""
        return Command(self.folder, "replay", *[DRIVE] * times, "--to", f"udp_multicast:{self.group}")

    def page(self, port, *more):
        return Command(self.folder, "serve", "--socket", self.status_socket, "--port", port, *more)

    def config(self):
        path = self.folder / "truck.yaml"
        text = (ROOT / "configs" / "class8.yaml").read_text()
        text = re.sub(r"^bus:.*$", "", text, flags=re.MULTILINE)
        path.write_text(f"{text}\nbus: {{interface: udp_multicast, channel: {self.group}}}\n")
        return path


def has_multicast():
    """Return whether datagrams to a group come back on this machine."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.settimeout(1.0)
        sock.bind(("", PORTS["own"]))
        group = socket.inet_aton("239.74.163.99") + socket.inet_aton("0.0.0.0")
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        sock.sendto(b"?", ("239.74.163.99", PORTS["own"]))
        return sock.recv(1) == b"?"
    return False


def get(port, path="/", method="GET", **headers):
    """Return (status, headers, body) of one request."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers=named, method=method)
    try:
        with urllib.request.build_opener(_Staying).open(request, timeout=10) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, error.read()


class _Staying(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_):
        return None


def history(port):
    return json.loads(get(port, "/history")[2])


class EventReader:
    """A page's connection for events."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), 5)
        self.socket.sendall(b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n")
        self.received = b""

    def read(self, until, timeout_s=5.0):
        self.socket.settimeout(timeout_s)
        while until not in self.received:
            part = self.socket.recv(1 << 16)
            if not part:
                break
            self.received += part
        return until in self.received

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()


@contextlib.contextmanager
def served(folder, stream):
    port = free_port()
    with Command(folder, "serve", "--socket", stream.status_socket, "--port", port) as process:
        assert wait_for(lambda: is_up(port), 20), process.output
        assert wait_for(lambda: history(port)["recent"], 10)
        process.port = port
        yield process


def resident_mb(pid):
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmRSS:\s+(\d+)", text)[1]) / 1024


def is_up(port):
    try:
        with socket.create_connection(("127.0.0.1", port), 1):
            return True
    except OSError:
        return False


__all__ = [
    "Command",
    "EventReader",
    "Stream",
    "Vehicle",
    "free_port",
    "get",
    "has_multicast",
    "history",
    "is_up",
    "resident_mb",
    "served",
    "wait_for",
]
