"""A daemon on a scripted bus in scripted time: hours pass in seconds, and nothing depends on the machine."""

from __future__ import annotations

import csv
import ctypes
import gc
import io
import itertools
import os
import socket
import time
from collections import Counter
from pathlib import Path

import numpy as np

from canest.bus.kernel_drain import Drained
from canest.config import load_config
from canest.core.frames import FrameBlock
from canest.live.daemon import Daemon
from canest.live.schedule import Schedule
from canest.logs.format_detection import open_log
from canest.node import node as node_module
from canest.system.journal import Journal
from canest.system.systemd_notify import Notifier

GUARD_US = 2_000


class Time:
    """A monotonic clock that moves only when somebody sleeps."""

    def __init__(self):
        self.now_ns = 10**12

    def clock_ns(self):
        return self.now_ns

    def sleep(self, s):
        self.now_ns += round(s * 1e9)


class Script:
    """A receiver and a transmitter in one: hands frames out when their time has come, keeps what is sent.

    ``offset_us``: what the bus's clock is ahead of the monotonic one; change it to set the clock.
    """

    def __init__(self, frames, time):
        self._frames, self._time, self._at = frames, time, 0
        begin_us = int(frames.t_us[0]) if len(frames) else 1_700_000_000_000_000
        self.offset_us = begin_us - time.now_ns // 1000
        self.state, self.reason, self.opened, self.counters, self.sent = "up", "", 1, Counter(), []
        self.max_poll_interval_us = 20_000

    def collect(self):
        return True

    def drain(self):
        now_us = self._time.now_ns // 1000 + self.offset_us
        end = int(np.searchsorted(self._frames.t_us, now_us, side="right"))
        # copies, as from a socket: a view that somebody keeps would keep the whole drive
        frames, self._at = self._frames[np.arange(self._at, end)], max(self._at, end)
        return Drained(frames, now_us - GUARD_US)

    def send(self, can_id, payload):
        self.counters["sent"] += 1
        self.sent.append((self._time.now_ns // 1000, can_id, payload))
        return True

    waiting = dropped_waiting = 0

    def failed(self):
        return []

    def drop_waiting(self):
        self.dropped_waiting += 1

    def repeat(self, now_us):
        """Hand the same frames out again, from now on."""
        frames, now_us = self._frames, now_us + self.offset_us
        shift = now_us - int(frames.t_us[0])
        self._frames = FrameBlock(frames.t_us + shift, frames.can_id, frames.length, frames.data)
        self._at = 0
        self.sent.clear()

    def fall_silent(self):
        """Hand out nothing more."""
        self._at = len(self._frames)

    def close(self):
        self.state = "absent"

    @property
    def exhausted(self):
        return self._at >= len(self._frames)


class Rig:
    """Runs a daemon tick by tick; use as a context manager."""

    def __init__(self, monkeypatch, config, frames=None, notifier=None, reload=None):
        self.time = Time()
        self.waits_for_reload = True  #: else it runs beside us, in real time
        self.script = Script(FrameBlock.empty() if frames is None else frames, self.time)
        self.opened = []

        def open_link(bus, filters, *, transmit, silent=False):
            self.opened.append((bus, transmit))
            return self.script, self.script if transmit else None

        monkeypatch.setattr(node_module, "open_link", open_link)
        monkeypatch.setattr(time, "monotonic_ns", self.time.clock_ns)
        monkeypatch.setattr(node_module, "boottime_us", lambda: self.now_us)
        self.log = io.StringIO()
        self.daemon = Daemon(
            config,
            config_name="test",
            reload=reload,
            journal=Journal(self.log, {"JOURNAL_STREAM": "1"}, lambda: self.time.now_ns * 1e-9),
            notifier=notifier or Notifier({}),
        )
        self.daemon.schedule = Schedule(self.time.clock_ns, self.time.sleep)

    def run(self, s):
        """Let ``s`` seconds pass."""
        end_ns = self.time.now_ns + round(s * 50) * 20_000_000
        while self.time.now_ns < end_ns:
            self.daemon.step()
            if self.waits_for_reload:
                self.daemon.reloads.wait(30)
        return self

    def run_out(self, extra_s=0.5):
        """Run until every frame has been handed out."""
        while not self.script.exhausted:
            self.run(1)
        return self.run(extra_s)

    @property
    def now_us(self):
        return self.time.now_ns // 1000

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.daemon.close()


def kenworth(data, seconds=None):
    """Return the first seconds of the real Kenworth log."""
    frames = FrameBlock.concatenate(list(open_log(data / "kenworth" / "normal.log.xz")))
    if seconds is None:
        return frames
    return frames[: int(np.searchsorted(frames.t_us, frames.t_us[0] + seconds * 1_000_000))]


def descriptors(ring):
    """Count this process's open files but for the segment that a ring writes: between two there is none."""
    links = (entry.readlink() for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink())
    return sum(not link.is_relative_to(ring) for link in links)


def wait_for(condition, timeout_s=5.0):
    """Wait in real time until a condition holds."""
    end = time.monotonic() + timeout_s
    for _ in itertools.count():
        if condition():
            return True
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return False


def free_port():
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return sock.getsockname()[1]


def config(tmp_path, *changes, name="vcan"):
    base = [f"service.state_dir={tmp_path}", "service.learn='off'", "estimator.name=canest"]
    return load_config(name, [*base, *changes])


def rows(path):
    with path.open() as file:
        return {r["t_s"]: tuple(r.values()) for r in csv.DictReader(file)}


def resident_kb():
    """Return what this process holds of memory, once freed pages are given back.

    A rig is fed with large drives: what glibc keeps of their room would count as growth.
    """
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") // 1024
