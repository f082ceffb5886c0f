"""A real broker (mosquitto) in a process of its own, and a client that collects what it gets."""

from __future__ import annotations

import contextlib
import json
import shutil
import signal
import socket
import subprocess
import threading
from pathlib import Path

from tests.serve.rig import free_port, is_up, wait_for

MOSQUITTO = shutil.which("mosquitto") or next(
    (str(path) for path in (Path("/usr/sbin/mosquitto"),) if path.exists()), None
)


class Broker:
    """mosquitto on a free port. lines: more of its configuration. Use as a context manager."""

    def __init__(self, folder, *lines, port=None):
        self.port = port or free_port()
        self._conf = folder / f"mosquitto-{self.port}.conf"
        self._log = folder / f"mosquitto-{self.port}.log"
        allow = [] if any(line.startswith("allow_anonymous") for line in lines) else ["allow_anonymous true"]
        text = [f"listener {self.port} 127.0.0.1", "user root", "persistence false", *allow, *lines]
        self._conf.write_text("\n".join(text) + "\n")
        self.process = None

    @property
    def url(self):
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self):
        with self._log.open("a") as log:
            self.process = subprocess.Popen([MOSQUITTO, "-c", self._conf], stdout=log, stderr=log)
        assert wait_for(lambda: is_up(self.port), 10), self._log.read_text()

    def send(self, number):
        self.process.send_signal(number)

    def end(self):
        self.process.send_signal(signal.SIGCONT)
        self.process.kill()
        self.process.wait(10)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.end()


class Listener:
    """Subscribes to everything; messages: (topic, text, retained) in the order of arrival."""

    def __init__(self, port, user=None, tls=None):
        from paho.mqtt import client as paho

        self.messages, self._lock = [], threading.Lock()
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        if user is not None:
            self._client.username_pw_set(*user)
        if tls is not None:
            self._client.tls_set_context(tls)
        self._client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        self._client.on_message = self._take
        self._client.connect("localhost" if tls else "127.0.0.1", port)
        self._client.loop_start()

    def _take(self, _client, _data, message):
        with self._lock:
            self.messages.append((message.topic, message.payload.decode(), bool(message.retain)))

    def of(self, topic):
        with self._lock:
            return [text for name, text, _ in self.messages if name == topic]

    def json(self, topic):
        return [json.loads(text) for text in self.of(topic)]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._client.disconnect()
        self._client.loop_stop()


class SilentServer:
    """A port that takes connections and answers nothing."""

    def __enter__(self):
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self.accepted = []
        self._thread = threading.Thread(target=self._accept, daemon=True)
        self._thread.start()
        return self

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                self.accepted.append(self._socket.accept()[0])

    def __exit__(self, *_):
        self._socket.close()
        for connection in self.accepted:
            connection.close()
