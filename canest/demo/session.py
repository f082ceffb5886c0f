"""Plays the bundled drive to the daemon over a loopback bus, faster than real time."""

from __future__ import annotations

import io
import os
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from canest.config import load_config
from canest.config.bus import Bus
from canest.core.errors import CanestError, UsageError
from canest.core.estimates import Estimates
from canest.core.frames import EXTENDED, ID_MASK, FrameBlock
from canest.demo import DRIVE, TRUTH
from canest.live.daemon import Daemon
from canest.logs.format_detection import open_log
from canest.logs.truth import read_truth
from canest.node.estimate_frame import NOT_AVAILABLE_STATUS, Estimate, decode
from canest.offline.scoring import Score
from canest.pipeline.signal_map import decoder_for
from canest.system.journal import Journal
from canest.system.python_can import can

if TYPE_CHECKING:
    from canest.config import Config
    from canest.logs.truth import Truth

CONFIG = "class8"
#: errors are counted from here on: the first half minute is the launch from rest
AFTER_S = 60.0
#: event time handed over at once; the daemon's own tick is 20 ms of real time
_STEP_S = 0.01
#: how long the daemon needs to broadcast its estimate of the last frames, once it has them
_BROADCAST_DELAY_S = 0.12
#: how long a busy machine may get on with none of them
_STALLED_S = 10.0
#: how long it may take to claim an address and make sure that nobody uses its group
_CLAIM_S = 5.0


@dataclass(slots=True)
class Moment:
    """The drive and its broadcast at one moment. `estimate` comes from the daemon's broadcast."""

    event_s: float
    duration_s: float
    estimate: Estimate
    broadcasts: int
    true_mass_kg: float
    true_grade: float


class Session:
    """The daemon on a virtual bus, and a player on the same bus; use as a context manager.

    speed: how many times faster than the drive was. overrides, options: see `load_config`.
    Errors: ConfigError; UsageError for overrides of what the demo itself needs.
    """

    def __init__(
        self, speed: float = 20.0, overrides: Iterable[str] = (), options: Mapping[str, str] | None = None
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="canest-demo-")
        folder = Path(self._folder.name)
        self._estimates = folder / "est.csv"
        bus = Bus(interface="virtual", channel=f"canest-demo-{os.getpid()}")
        own = [
            f"bus.interface={bus.interface}",
            f"bus.channel={bus.channel}",
            "broadcast.enabled=true",
            "broadcast.rate_hz=50",
            "service.learn=off",
            f"service.state_dir='{folder}'",
            f"service.log_estimates='{self._estimates}'",
        ]
        try:
            self.config: Config = load_config(CONFIG, [*own, *overrides], options)
            _refuse(self.config, "bus", self.config.bus != bus)
            _refuse(
                self.config,
                "service.log_estimates",
                self.config.service.log_estimates != str(self._estimates),
            )
        except CanestError:
            self._folder.cleanup()
            raise
        self.speed = speed
        self.truth: Truth = read_truth(TRUTH)
        self._score = Score(self.truth, None, AFTER_S)
        self.frames = FrameBlock.concatenate([b for b in open_log(DRIVE) if isinstance(b, FrameBlock)])
        self.journal = io.StringIO()
        self.daemon = Daemon(self.config, config_name=CONFIG, journal=Journal(self.journal))
        # its frames keep the stamps of the drive, and the daemon's broadcast comes back on it
        self._bus = can.Bus(interface=bus.interface, channel=bus.channel, preserve_timestamps=True)
        self._thread = threading.Thread(target=self._work, name="daemon", daemon=True)
        self._failure: BaseException | None = None
        self._estimate, self._broadcasts, self._sent = Estimate(), 0, 0
        wanted_us = decoder_for(self.config).select(self.frames).t_us
        self._last_us = int(wanted_us[-1]) if len(wanted_us) else None  #: where the daemon's clock ends

    def __enter__(self) -> Session:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.daemon.stop()
        self._thread.join(5.0)
        self._bus.shutdown()
        self._folder.cleanup()

    @property
    def duration_s(self) -> float:
        """Length of the drive."""
        return float(self.frames.t_us[-1] - self.frames.t_us[0]) * 1e-6

    def play(self, every_s: float) -> Iterator[Moment]:
        """Play the drive; yield a `Moment` every ``every_s`` seconds of real time, and one at the end."""
        self._wait_for_broadcast()
        begin = time.monotonic()
        due = 0.0
        while self._sent < len(self.frames):
            passed = time.monotonic() - begin
            self._send_until(passed * self.speed)
            self._receive()
            if passed >= due:
                due = passed + every_s
                yield self.moment()
            time.sleep(_STEP_S)
            if self._failure is not None:
                raise CanestError(f"the daemon ended: {self._failure}")
        self._wait_for_the_last()
        yield self.moment()

    def moment(self) -> Moment:
        """Return what is known now."""
        at = max(self._sent - 1, 0)
        t_us = self.frames.t_us[at : at + 1]
        mass_kg, grade = self._score.truth_at(t_us)
        return Moment(
            float(t_us[0] - self.frames.t_us[0]) * 1e-6,
            self.duration_s,
            self._estimate,
            self._broadcasts,
            float(mass_kg[0]),
            float(grade[0]),
        )

    def finish(self) -> tuple[Estimates, Score]:
        """Stop the daemon; return every estimate it made, and their errors against the truth."""
        self.daemon.stop()
        self._thread.join(5.0)
        estimates = _read_estimates(self._estimates)
        self._score.add(estimates)
        return estimates, self._score

    def _wait_for_broadcast(self) -> None:
        end = time.monotonic() + _CLAIM_S
        while not self._broadcasts and self._failure is None and time.monotonic() < end:
            time.sleep(_STEP_S)
            self._receive()

    def _wait_for_the_last(self) -> None:
        """Give a busy machine the time it needs for the last frames, while it gets on with them."""
        reached_us: int | None = -1
        since, patience_s = time.monotonic(), _STALLED_S
        while time.monotonic() - since < patience_s and self._failure is None:
            now_us = self.daemon.pipeline.clock.last_us
            if now_us != reached_us:
                reached_us, since = now_us, time.monotonic()
                patience_s = _BROADCAST_DELAY_S if now_us == self._last_us else _STALLED_S
            time.sleep(_STEP_S)
            self._receive()

    def _work(self) -> None:
        try:
            self.daemon.run(handle_signals=False)
        except BaseException as error:  # raised by `play`
            self._failure = error

    def _send_until(self, event_s: float) -> None:
        t_us = self.frames.t_us
        end = int(np.searchsorted(t_us, t_us[0] + round(event_s * 1e6), side="right"))
        part = self.frames[self._sent : end]
        self._sent = end
        for stamp, can_id, length, word in zip(
            part.t_us.tolist(), part.can_id.tolist(), part.length.tolist(), part.data.tolist(), strict=True
        ):
            self._bus.send(
                can.Message(
                    timestamp=stamp * 1e-6,
                    arbitration_id=can_id & ID_MASK,
                    is_extended_id=bool(can_id & EXTENDED),
                    data=word.to_bytes(8, "little")[:length],
                )
            )

    def _receive(self) -> None:
        while (message := self._bus.recv(0)) is not None:
            if message.arbitration_id >> 8 & 0x1FFFF != self.config.broadcast.pgn:
                continue
            can_id = message.arbitration_id | EXTENDED
            received = decode(bytes(message.data), can_id)
            if received is not None and received.intact:
                self._broadcasts += 1
                over = self._sent == len(self.frames)
                # the bus is silent then, so "not available" follows: keep the last estimate of the drive
                if not (over and received.estimate.status == NOT_AVAILABLE_STATUS):
                    self._estimate = received.estimate


def _refuse(config: Config, key: str, changed: bool) -> None:
    if changed:
        what = "is the demo's own, which plays to itself over a loopback bus"
        raise UsageError(what, where=config.at(key), expected="another key (canest run takes this one)")


def _read_estimates(path: Path) -> Estimates:
    """Return what the daemon wrote (t_s and numbers; status and gate are not needed here)."""
    table = [line.split(",") for line in path.read_text(encoding="ascii").splitlines()[1:]]
    t_us = np.array([round(float(row[0]) * 1e6) for row in table], np.int64)
    mass, mass_std, grade, grade_std = (
        np.array([float(row[column] or "nan") for row in table]) for column in range(1, 5)
    )
    nothing = np.zeros(len(table), np.uint8)
    return Estimates(t_us, mass, mass_std, grade, grade_std, nothing, nothing)
