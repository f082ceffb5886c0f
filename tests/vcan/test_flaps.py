"""Memory while an interface is deleted and created again, over and over, on a real vcan."""

from __future__ import annotations

import gc
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest

from canest.bus.socketcan import SocketCanReceiver

pytestmark = [pytest.mark.vcan, pytest.mark.slow]
BUS = "vflap0"
FLAPS, PARTS = (
    2000,
    8,
)  #: in parts, since a test that takes over 90 s in the guest is taken for one that hangs
WARM_UP = 50
#: one set of buffers is 0.3 MB, so 2000 that stay are 600; 2 MB of the heap come and go by themselves
MOST_GROWTH_MB = 6.0


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


class Flapping:
    """A receiver whose interface is deleted and created again, and the memory it began with."""

    def __init__(self, ip: IO[str]) -> None:
        self._ip = ip
        self.receiver = SocketCanReceiver(BUS, [(0, 0)])
        self.flap(WARM_UP)
        self._begin_mb = resident_mb()

    @property
    def growth_mb(self) -> float:
        return resident_mb() - self._begin_mb

    def flap(self, times: int) -> None:
        for _ in range(times):
            self._command(f"link add {BUS} type vcan", f"link set {BUS} up")
            self._drain_until("up")
            self._command(f"link delete {BUS}")
            self._drain_until("absent")

    def _command(self, *lines: str) -> None:
        self._ip.writelines(f"{line}\n" for line in lines)
        self._ip.flush()

    def _drain_until(self, state: str) -> None:
        deadline_s = time.monotonic() + 30.0
        while self.receiver.state != state:
            assert time.monotonic() < deadline_s, f"the interface is {self.receiver.state}, not {state}"
            if state == "up":
                self.receiver.request_check()  # now, not in 20 ms
            self.receiver.drain()
            time.sleep(0.002)


@pytest.fixture(scope="module")
def flapping() -> Iterator[Flapping]:
    """Flap by one ``ip`` that stays, for to start one takes long in a guest; the collector is off."""
    with subprocess.Popen(["ip", "-force", "-batch", "-"], stdin=subprocess.PIPE, text=True) as ip:
        assert ip.stdin is not None
        gc.collect()
        gc.disable()
        try:
            flapping = Flapping(ip.stdin)
            yield flapping
            flapping.receiver.close()
        finally:
            gc.enable()
            ip.stdin.close()


@pytest.mark.parametrize("part", range(1, PARTS + 1))
def test_memory_is_flat_over_two_thousand_recreations(
    flapping: Flapping, part: int, record_property: Callable[[str, object], None]
) -> None:
    """Whatever a lost interface leaves for the collector shows as growth."""
    flapping.flap(FLAPS // PARTS)
    record_property("growth_mb", round(flapping.growth_mb, 2))
    assert flapping.growth_mb < MOST_GROWTH_MB
    flaps = WARM_UP + part * FLAPS // PARTS
    assert flapping.receiver.opened == flaps
    # the error's own path, not only that of the watched index
    assert flapping.receiver.counters["receive_enodev"] > flaps // 4
