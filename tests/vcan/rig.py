"""What the vcan tests share: traffic on a bus, the daemon as a process, and a receiver of its broadcast."""

from __future__ import annotations

import contextlib
import json
import lzma
import os
import shlex
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cantools
from guest import testing

ROOT = Path(__file__).parents[2]
#: One cycle of a truck of 21 t on 1 % grade (`make_drive.py`).
CYCLE = ROOT / "tests" / "data" / "vcan" / "cycle.log.xz"
#: Thirty seconds each of a real truck, with real attacks.
KENWORTH = ROOT / "tests" / "data" / "kenworth"
TRUE_MASS_KG, TRUE_GRADE = 21_000.0, 0.01
PGN, ADDRESS = 0xFF5A, 158
#: Python starts some 20 times slower in an emulated machine, and more slowly still on a busy one.
START_S = 90.0
_IDLE_GUEST_S = 0.25  #: what `slowness` measures in QEMU on an idle machine of 2020
#: what an emulated processor adds to a recovery, on an idle host: of 1.7 s until a daemon estimates on an
#: interface that was made anew
_EMULATED_S = 0.5
_FRAME = struct.Struct("=IB3x8s")


def slowness() -> float:
    """How much slower than an idle emulated machine this one is just now; 1 where it is not.

    Limits in seconds are multiplied with it: a guest on a busy host gets a fraction of a processor.
    """
    begin_s = time.perf_counter()
    sum(n * n % 7 for n in range(100_000))
    return max(1.0, (time.perf_counter() - begin_s) / _IDLE_GUEST_S)


def wait_until(condition: Callable[[], Any], timeout_s: float, what: str, every_s: float = 0.05) -> Any:
    """Return the condition's first truthy value; fail past the time, saying ``what`` did not come.

    every_s: where looking starts a process, long enough to leave the one processor to who is waited for.
    """
    deadline_s = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline_s, f"{what}: not within {timeout_s:g} s"
        time.sleep(every_s)
    return value


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, timeout=20)


def add_vcan(name: str) -> None:
    ip("link", "add", name, "type", "vcan")
    ip("link", "set", name, "up")


@dataclass(frozen=True, slots=True)
class ReceivedBroadcast:
    """A broadcast: when (monotonic, s), from which address, its payload and its signals by name."""

    t_s: float
    source: int
    payload: bytes
    signals: dict[str, Any]

    @property
    def mass_kg(self) -> float | None:
        return self.signals["EstimatedMass"]

    @property
    def fresh(self) -> bool:
        """An estimate of now, with numbers."""
        return self.signals["EstimateStatus"] in (1, 2) and self.mass_kg is not None


@cache
def message() -> Any:
    """``CanestEstimate`` as cantools reads it."""
    return cantools.database.load_file(ROOT / "dbc" / "canest.dbc").get_message_by_name("CanestEstimate")


def decode(payload: bytes) -> dict[str, Any]:
    """Decode a broadcast with plain cantools; None where J1939 says "not available" (all ones)."""
    raw = message().decode(payload, decode_choices=False, scaling=False)
    scaled = message().decode(payload, decode_choices=False)
    ones = {s.name: (1 << s.length) - 1 for s in message().signals}
    measured = ("EstimatedMass", "EstimatedMassStd", "EstimatedGrade", "EstimatedGradeStd")
    return {name: None if name in measured and raw[name] == ones[name] else scaled[name] for name in scaled}


def is_sound(can_id: int, payload: bytes) -> bool:
    """Whether byte 8 has the sum of all other nibbles, those of the 29-bit identifier included, modulo 16."""
    nibbles = f"{can_id & 0x1FFF_FFFF:08x}{payload.hex()[:14]}{payload.hex()[15:]}"
    return len(payload) == 8 and sum(int(nibble, 16) for nibble in nibbles) % 16 == payload[7] >> 4


def gate_code(label: str) -> int:
    """Return the number of a gate in the frame."""
    choices = message().get_signal_by_name("EstimateGate").choices
    return next(int(number) for number, name in choices.items() if str(name) == label)


class BroadcastReceiver:
    """Receives the broadcast on one interface. Use as a context manager."""

    def __init__(self, interface: str) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        only = struct.pack("=II", socket.CAN_EFF_FLAG | PGN << 8, socket.CAN_EFF_FLAG | 0x3FFFF00)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, only)
        self._socket.bind((interface,))

    def __enter__(self) -> BroadcastReceiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def receive(self, timeout_s: float) -> ReceivedBroadcast | None:
        """Return the next broadcast, None if none comes in time; what is damaged or noise is passed over."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            self._socket.settimeout(max(0.001, deadline_s - time.monotonic()))
            try:
                can_id, length, data = _FRAME.unpack(self._socket.recv(16))
            except (TimeoutError, OSError):
                return None
            if is_sound(can_id, data[:length]):
                return ReceivedBroadcast(
                    time.monotonic(), can_id & 0xFF, data[:length], decode(data[:length])
                )

    def flush(self) -> None:
        """Forget what has been received so far."""
        self._socket.settimeout(0.0)
        with contextlib.suppress(BlockingIOError, OSError):
            while True:
                self._socket.recv(16)

    def waiting(self) -> list[ReceivedBroadcast]:
        """Return what has been received and not been asked for yet."""
        return list(iter(lambda: self.receive(0.0), None))

    def until(
        self, wanted: Callable[[ReceivedBroadcast], bool], timeout_s: float, what: str
    ) -> ReceivedBroadcast:
        """Return the first broadcast from now on that is ``wanted``; fail past the time."""
        self.flush()
        deadline_s = time.monotonic() + timeout_s
        last: ReceivedBroadcast | None = None
        while (left_s := deadline_s - time.monotonic()) > 0:
            received = self.receive(left_s)
            if received is not None and wanted(received):
                return received
            last = received or last
        raise AssertionError(f"{what}: not within {timeout_s:g} s; last received {last}")

    def fresh(self, since_s: float, within_s: float, what: str) -> float:
        """Wait for an estimate of now; return the seconds it took from ``since_s`` (monotonic) on.

        Fails when that is more than ``within_s``, stretched by `slowness`, and more in a guest machine.
        """
        took_s = self.until(lambda received: received.fresh, 60.0, f"an estimate after {what}").t_s - since_s
        limit_s = within_s * slowness() + _EMULATED_S * testing.inside()
        assert took_s <= limit_s, f"{what}: an estimate after {took_s:.2f} s, expected within {limit_s:.2f} s"
        return took_s


def cycle_log(folder: Path, *, without: tuple[int, ...] = (), frozen: tuple[int, ...] = ()) -> Path:
    """Unpack the cycle, without the frames of some identifiers, those of others all alike; return the log."""
    path = folder / f"cycle{''.join(f'-{can_id:08X}' for can_id in (*without, *frozen))}.log"
    dropped = {f"{can_id:08X}" for can_id in without}
    kept = {f"{can_id:08X}": "" for can_id in frozen}
    lines = []
    with lzma.open(CYCLE, "rt") as log:
        for line in log:
            stamp, channel, frame = line.split()
            name, payload = frame.split("#")
            if name in kept:
                payload = kept[name] = kept[name] or payload
            if name not in dropped:
                lines.append(f"{stamp} {channel} {name}#{payload}\n")
    path.write_text("".join(lines))
    return path


def kenworth_log(folder: Path, name: str, groups: tuple[str, ...] = ()) -> Path:
    """Unpack a real log as canplayer wants it, of some groups (PF in hexadecimal) only or all of them."""
    path = folder / f"{name}{'-'.join(groups)}.log"
    lines = []
    with lzma.open(KENWORTH / f"{name}.log.xz", "rt") as log:
        for line in log:
            stamp, _, can_id, _, *payload = line.split()
            if not groups or can_id[2:4] in groups:
                lines.append(f"{stamp} can0 {can_id}#{''.join(payload)}\n")
    path.write_text("".join(lines))
    return path


@contextlib.contextmanager
def playing(interface: str, log: Path, beat_ms: int = 5) -> Iterator[None]:
    """Play a log round and round, as often as the interface comes and goes; looks every ``beat_ms``."""
    player = shlex.join(["canplayer", "-g", str(beat_ms), "-l", "i", "-I", str(log), f"{interface}=can0"])
    loop = f"while :; do {player}; sleep 0.05; done"
    process = subprocess.Popen(["bash", "-c", loop], stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextlib.contextmanager
def recording(interface: str, log: Path) -> Iterator[Path]:
    """Record an interface with candump, from the moment the block begins, not some time after."""
    listeners = Path("/proc/net/can/rcvlist_all")
    before = listeners.read_text().count(f" {interface} ")
    with (
        log.open("w") as file,
        subprocess.Popen(["candump", "-r", "4194304", "-L", interface], stdout=file) as dump,
    ):
        try:
            wait_until(
                lambda: listeners.read_text().count(f" {interface} ") > before, START_S, "candump to listen"
            )
            yield log
        finally:
            dump.terminate()


class Daemon:
    """``canest run`` on one interface, its messages in ``log``, its state in ``folder``.

    prefix: words before the command, e.g. to take privileges away.
    """

    def __init__(
        self, interface: str, folder: Path, *options: str, config: str = "vcan", prefix: tuple[str, ...] = ()
    ) -> None:
        self.interface, self.folder = interface, folder
        folder.mkdir(exist_ok=True)
        self.log = folder.with_suffix(".err")  # beside, since tests mount over the folder
        self._config = config
        changes = [f"bus.channel={interface}", f"service.state_dir={folder}", "service.learn='on+save'"]
        # a mass that was restored with a large standard deviation would move by learning alone
        changes.append("service.restore_std=0.002")
        self._command = [*prefix, sys.executable, "-m", "canest", "run", "-c", config]
        self._command += [word for change in changes for word in ("--set", change)] + list(options)
        self.process: subprocess.Popen[bytes] | None = None

    def launch(self) -> None:
        """Start without waiting; `started` waits."""
        self._begun = self.log.stat().st_size if self.log.exists() else 0
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(self._command, cwd=ROOT, stderr=log, stdout=log)

    def started(self, timeout_s: float = START_S) -> Daemon:
        """Wait until it works."""
        wait_until(
            lambda: not self.alive or "started" in self.messages(self._begun), timeout_s, "daemon to start"
        )
        assert self.alive, self.messages()
        return self

    def start(self) -> Daemon:
        """Start and wait until it works."""
        self.launch()
        return self.started()

    def __enter__(self) -> Daemon:
        return self.start()

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def remember(self, mass_kg: float, mass_std_kg: float) -> None:
        """Leave a learned mass for the next start to find, as an earlier life would have."""
        from canest.config import load_config
        from canest.live.state import Learned, fingerprint, save, vehicle_key

        config = load_config(self._config)
        learned = Learned(
            vehicle_key(config), fingerprint(config), mass_kg, mass_std_kg, time.time(), standing=False
        )
        save(self.folder / f"learned-{self.interface}.json", learned)

    @property
    def alive(self) -> bool:
        return self.process is not None and self.process.poll() is None

    def messages(self, begin: int = 0) -> str:
        """Return what it has logged, from a byte on."""
        return self.log.read_bytes()[begin:].decode()

    def signal(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def stop(self, timeout_s: float = 10.0) -> tuple[int, float]:
        """End it with SIGTERM; return its exit status and the seconds it took."""
        assert self.process is not None
        begin_s = time.monotonic()
        self.process.terminate()
        return self.process.wait(timeout_s), time.monotonic() - begin_s

    def status(self) -> dict[str, Any]:
        """Return the snapshot that the daemon gives to whoever connects."""
        return ask(self.folder / f"status-{self.interface}.sock")


def ask(path: Path, timeout_s: float = 10.0) -> dict[str, Any]:
    """Read one JSON object from a local socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.settimeout(timeout_s)
        client.connect(str(path))
        parts = []
        while part := client.recv(1 << 16):
            parts.append(part)
    answer: dict[str, Any] = json.loads(b"".join(parts))
    return answer
