"""Another node in our group: shown and logged while we send there too."""

from __future__ import annotations

import pytest

from canest.core.frames import FrameBlock
from canest.decode import j1939
from canest.telemetry.snapshot import snapshot
from canest.telemetry.status_view import rows
from tests.live.rig import Rig, config

ENGINE, OTHER = j1939.pack(0xF004, 0x00), j1939.pack(0xFF5A, 0x9F)


def bus(other_from_s: int, other_to_s: int, end_s: int = 80) -> FrameBlock:
    """Return a bus with an engine, and another node in our group for some seconds."""
    frames = [(s * 1_000_000, ENGINE, bytes(8)) for s in range(end_s)]
    frames += [(s * 1_000_000, OTHER, bytes(8)) for s in range(other_from_s, other_to_s)]
    return FrameBlock.from_frames(sorted(frames))


def shown(rig: Rig) -> dict[str, str]:
    return dict(rows(snapshot(rig.daemon.view(rig.now_us))))


def logged(rig: Rig) -> list[str]:
    return [line for line in rig.log.getvalue().splitlines() if "group-used-by-others" in line]


def test_who_begins_after_us_is_shown_and_logged_until_it_has_stopped(tmp_path, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), bus(3, 8)) as rig:
        rig.run(2.5)
        assert "group shared" not in shown(rig)
        assert logged(rig) == []
        rig.run(4)
        assert shown(rig)["broadcast"] == "on, from address 0x9e"
        assert shown(rig)["group shared"].startswith("also sent from 0x9f: receivers get both. Stop one")
        assert logged(rig) == ["<4>group-used-by-others now=0x9f"]
        rig.run(65)
        assert "group shared" not in shown(rig)
        assert logged(rig)[1:] == ["<5>group-used-by-others now=none"]


@pytest.mark.parametrize("change", ["broadcast.rate_hz=4", "broadcast.listen_only=true"])
def test_who_was_there_before_us_is_the_reason_of_our_silence_and_no_second_warning(
    tmp_path, monkeypatch, change
):
    with Rig(monkeypatch, config(tmp_path, change), bus(0, 8)) as rig:
        rig.run(5)
        assert shown(rig)["broadcast"].startswith("silent")
        assert "group shared" not in shown(rig)
        assert logged(rig) == []
