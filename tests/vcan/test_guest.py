"""What the other tests here stand on: the bus is real, systemd is real, the tools talk to each other."""

from __future__ import annotations

import subprocess
from pathlib import Path

import can
import pytest
import rig

pytestmark = pytest.mark.vcan


def test_a_frame_from_cansend_arrives_on_a_raw_socket(vcan: str) -> None:
    with can.Bus(interface="socketcan", channel=vcan) as bus:
        subprocess.run(["cansend", vcan, "18FEF127#0102030405060708"], check=True, timeout=10)
        frame = bus.recv(timeout=10)
    assert frame is not None
    assert (frame.arbitration_id, bytes(frame.data)) == (0x18FEF127, bytes(range(1, 9)))


def test_canplayer_replays_what_candump_recorded(vcan: str, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    frames = [f"({n / 1000:.6f}) can0 18FEF127#{n:016X}" for n in range(200)]
    log.write_text("\n".join(frames) + "\n")
    with rig.recording(vcan, tmp_path / "seen.log") as recorded:
        subprocess.run(["canplayer", "-I", str(log), f"{vcan}=can0"], check=True, timeout=30)
        seen = rig.wait_until(
            lambda: len(lines := recorded.read_text().splitlines()) == 200 and lines, 30.0, "all"
        )
    assert [line.split()[2] for line in seen] == [line.split()[2] for line in frames]


@pytest.mark.guest
def test_systemd_is_process_one_and_up() -> None:
    assert Path("/proc/1/comm").read_text().strip() == "systemd"
    state = subprocess.run(
        ["systemctl", "is-system-running"], capture_output=True, text=True, timeout=30, check=False
    )
    assert state.stdout.strip() in {"running", "starting"}
