"""A local socket that serves the daemon's snapshot: connect, read one JSON object, done."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from canest.config.schema import Config
from canest.config.state_directory import state_dir
from canest.core.errors import UsageError

ANSWER_S = 3.0  #: for an answer as a whole; a daemon answers its clients every second
_CLIENTS = 32  #: waiting at once
_FRESH_S = 3.0  #: an answer in a file that is older is of another time
_ANSWER_LARGEST = 1 << 24  #: bytes
_RETRY_S = 0.05
_SYSTEM_FOLDERS = ("/run/canest", "/run")
_LISTENS = "00010000"  #: flags of a socket that listens, in /proc/net/unix (__SO_ACCEPTCON of the kernel)


def socket_path(config: Config, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where the daemon of this config listens: systemd's runtime directory, else the state's."""
    given = environment.get("RUNTIME_DIRECTORY", "").split(":")[0]
    folder = Path(given) if given else state_dir(config, environment)
    return folder / f"status-{config.bus.file_name}.sock"


class StatusServer:
    """Answers whoever connects. `poll` costs one system call when nobody does.

    publish: where given, takes the answer as JSON whenever more clients wait than one `poll` answers; its
    place is `published_path`. Anybody can keep the queue of a socket full, nobody the readers from a file.
    Errors: OSError; UsageError when a daemon that runs listens under this name already.
    """

    def __init__(self, path: Path, publish: Callable[[bytes], object] | None = None) -> None:
        self.path, self._publish = path, publish
        path.parent.mkdir(parents=True, exist_ok=True)
        refuse_second_daemon(path)
        path.unlink(missing_ok=True)  # left behind by a daemon that was killed
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.bind(str(path))
        path.chmod(0o666)  # everybody who reaches the directory may read the status
        self._created_ns = path.stat().st_mtime_ns  # inodes are used again at once
        self._device = path.parent.stat().st_dev
        self._socket.listen(_CLIENTS)

    def poll(self, content: Callable[[], dict[str, Any]]) -> None:
        """Answer the clients that wait, at most 32, all with the same."""
        answer = b""
        for _ in range(_CLIENTS):
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            answer = answer or json.dumps(content()).encode()
            with client, contextlib.suppress(OSError):  # a client that left, or does not read
                client.setblocking(False)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
                client.send(answer)
        if self._publish is not None:
            self._publish(answer)

    @property
    def is_lost(self) -> bool:
        """Return whether the name is gone. Behind a file system mounted over it, it is there again later."""
        try:
            return not self.path.exists() and self.path.parent.stat().st_dev == self._device
        except OSError:  # nor is there a folder
            return True

    def close(self, *, keep_name: bool = False) -> None:
        """Stop answering and take the socket's name away, unless it is another server's by now."""
        self._socket.close()
        with contextlib.suppress(OSError):
            if not keep_name and self.path.stat().st_mtime_ns == self._created_ns:
                self.path.unlink()
                published_path(self.path).unlink(missing_ok=True)


def published_path(path: Path) -> Path:
    """Return the file that holds a daemon's answer while its socket is crowded."""
    return path.with_suffix(".json")


def refuse_second_daemon(path: Path) -> None:
    """Raise UsageError where somebody listens on a socket of this name."""
    with _client() as client:
        try:
            client.connect(str(path))
        except BlockingIOError:
            pass  # somebody does, and has more clients waiting than there is room for
        except OSError:
            return
    raise UsageError(
        "a daemon of this config is running already",
        where=str(path),
        expected="one per bus, or another service.state_dir",
    )


def _client() -> socket.socket:
    client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    client.settimeout(ANSWER_S)
    return client


def read_status(path: Path) -> dict[str, Any]:
    """Return a running daemon's snapshot. Errors: OSError, ValueError when nobody answers properly."""
    answer = json.loads(_answer(path, time.monotonic() + ANSWER_S))
    if not isinstance(answer, dict):
        raise ValueError("the answer is not an object")  # noqa: TRY004 - a bad answer, not a wrong argument
    return answer


def _answer(path: Path, until_s: float) -> bytes:
    """Return what a daemon answers before a monotonic time, or has published where its socket is crowded."""
    with _client() as client:
        while True:
            try:
                client.connect(str(path))
                break
            except BlockingIOError:  # others wait already
                published = _published(path)
                if published is not None:
                    return published
                if time.monotonic() > until_s:
                    raise
                time.sleep(_RETRY_S)
        answer = bytearray()
        while part := _receive(client, until_s):
            answer += part
            if len(answer) > _ANSWER_LARGEST:
                raise ValueError("the answer does not end")
    return bytes(answer)


def _receive(client: socket.socket, until_s: float) -> bytes:
    left_s = until_s - time.monotonic()
    if left_s <= 0:
        raise TimeoutError("timed out")
    client.settimeout(left_s)
    return client.recv(1 << 16)


def _published(path: Path) -> bytes | None:
    try:
        with published_path(path).open("rb") as file:
            age_s = time.time() - os.fstat(file.fileno()).st_mtime
            return file.read(_ANSWER_LARGEST) if abs(age_s) < _FRESH_S else None
    except OSError:
        return None


def find_sockets(environment: Mapping[str, str] = os.environ) -> Iterator[Path]:
    """Yield the sockets of daemons on this machine, wherever they usually are."""
    folders = [Path(f) for f in _SYSTEM_FOLDERS]
    folders += sorted(p for p in Path("/run/canest").glob("*") if p.is_dir())
    with contextlib.suppress(RuntimeError):  # a user without an entry, as in containers, has no home
        folders.append(Path(environment.get("HOME", "~")).expanduser() / ".local/state/canest")
    for folder in folders:
        yield from sorted(folder.glob("status-*.sock"))


def running_sockets(table: Path = Path("/proc/net/unix")) -> list[Path]:
    """Return the sockets of daemons in the usual places, and in any other place those of root's and our own.

    table: of the kernel, with the sockets of this network namespace; without it, the usual places alone.
    """
    found = list(find_sockets())
    try:
        lines = table.read_text(encoding="utf-8", errors="surrogateescape").splitlines()[1:]
    except OSError:  # not Linux
        return found
    for line in lines:
        fields = line.split(maxsplit=7)
        if len(fields) < 8 or fields[3] != _LISTENS:
            continue
        path = Path(fields[7])
        if path.is_absolute() and path.match("status-*.sock") and path not in found:
            with contextlib.suppress(OSError):  # it has gone, or is out of reach
                if path.stat().st_uid in (0, os.getuid()):  # anybody may call a socket so
                    found.append(path)
    return found
