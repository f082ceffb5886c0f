"""The command of docs/outputs.md that decodes the broadcast with cantools, whatever address was claimed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from canest.config.bus import Broadcast
from canest.core.frames import EXTENDED, FrameBlock
from canest.logs.candump_writer import candump_text
from canest.node.broadcast import Broadcaster
from canest.node.estimate_frame import Estimate

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("address", [0x9E, 0x80, 0xF7])
def test_cantools_knows_the_broadcast_of_any_address(address):
    shown = re.search(r"python -m (cantools decode .*)", (ROOT / "docs" / "outputs.md").read_text())[1]
    sender = Broadcaster(Broadcast(enabled=True))
    sender.set_estimate(Estimate(21_000.0, 210.0, 0.03, 0.002, 2, 0), 1_000_000)
    sent = sender.frames(1_000_000, address, frozenset())
    text = candump_text(FrameBlock.from_frames([(1_000_000, i | EXTENDED, data) for i, data in sent]))
    done = subprocess.run(
        [sys.executable, "-m", *shown.split()],
        input=text,
        capture_output=True,
        cwd=ROOT,
        check=True,
        timeout=60,
    )
    decoded = done.stdout.decode()
    assert f"{address:02X}#" in decoded and "Unknown frame id" not in decoded
    assert "EstimatedMass: 21000 kg" in decoded and "EstimateStatus: valid" in decoded
