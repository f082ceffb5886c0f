"""Memory while an interface is deleted and created again, over and over, on a real vcan."""

from __future__ import annotations

import gc
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rig

from canest.live.socketcan import SocketCanReceiver

pytestmark = [pytest.mark.vcan, pytest.mark.slow]
BUS = "vflap0"
FLAPS = 2000
WARM_UP = 50
MOST_GROWTH_MB = 2.0  #: one set of buffers is 0.27 MB


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


@pytest.fixture
def command() -> Iterator[Callable[[str], None]]:
    """Give commands to one ``ip`` that stays: to start one costs tens of milliseconds in a guest."""
    with subprocess.Popen(["ip", "-force", "-batch", "-"], stdin=subprocess.PIPE, text=True) as process:

        def give(words: str) -> None:
            assert process.stdin is not None
            process.stdin.write(words + "\n")
            process.stdin.flush()

        yield give
        give(f"link delete {BUS}")


def drain_until(receiver: SocketCanReceiver, state: str) -> None:
    deadline_s = time.monotonic() + 30.0
    while receiver.state != state:
        assert time.monotonic() < deadline_s, f"the interface is {receiver.state}, not {state}"
        receiver.drain()
        time.sleep(0.001)


def test_memory_is_flat_over_two_thousand_recreations(
    command: Callable[[str], None], record_property: Callable[[str, object], None]
) -> None:
    """The collector is off: whatever a lost interface leaves for it shows as growth."""
    receiver = SocketCanReceiver(BUS, [(0, 0)])
    rig.wait_until(lambda: receiver.state == "absent", 1.0, "no interface yet")
    begin_mb = 0.0
    gc.collect()
    gc.disable()
    try:
        for flap in range(WARM_UP + FLAPS):
            if flap == WARM_UP:
                begin_mb = resident_mb()
            command(f"link add {BUS} type vcan")
            command(f"link set {BUS} up")
            drain_until(receiver, "up")
            command(f"link delete {BUS}")
            drain_until(receiver, "absent")
        growth_mb = resident_mb() - begin_mb
    finally:
        gc.enable()
    print(f"grew by {growth_mb:.2f} MB over {FLAPS} flaps; {dict(receiver.counters)}")
    record_property("growth_mb", growth_mb)
    assert receiver.counters["receive_enodev"] > FLAPS // 2  # the error's own path, not only the watched index
    assert receiver.opened == WARM_UP + FLAPS
    assert growth_mb < MOST_GROWTH_MB
    receiver.close()
