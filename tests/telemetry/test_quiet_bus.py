"""A bus that has fallen silent: the last known mass stays visible, with its age."""

from __future__ import annotations

import json
import math

import pytest

from canest.decode import j1939
from canest.node.estimate_frame import Estimate, encode
from canest.telemetry import metrics
from canest.telemetry.broadcast_view import LiveView
from canest.telemetry.snapshot import snapshot
from canest.telemetry.status_view import age, rows
from tests.live.rig import Rig, config

PGN = 0xFF5A
CAN_ID = j1939.pack(PGN, 0x80, 6)


def test_a_quiet_bus_still_shows_the_last_known_mass_with_its_age(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(60)
        before = rig.daemon.estimate(rig.now_us)
        rig.script.fall_silent()
        rig.run(35)
        shown = snapshot(rig.daemon.view(rig.now_us))
    assert math.isfinite(before.mass_kg)
    assert shown["estimate"]["mass_kg"] is None
    known = shown["last_known"]
    assert known["mass_kg"] == pytest.approx(before.mass_kg, rel=0.01)
    assert known["status"] == "valid"
    assert known["age_s"] == pytest.approx(33, abs=1)  # ticks go on for `hold_s`
    assert shown["bus"]["quiet_s"] == pytest.approx(35, abs=0.5)
    text = dict(rows(shown))["last known"]
    assert f"{known['mass_kg']:,.0f} kg" in text and text.endswith("s ago")
    exposed = metrics.text(shown)
    assert f"canest_last_mass_kilograms {known['mass_kg']}" in exposed
    assert f"canest_last_mass_age_seconds {known['age_s']}" in exposed
    assert 'event="quiet_s"' not in exposed
    json.dumps(shown, allow_nan=False)


def test_while_there_is_an_estimate_status_shows_no_last_known_one(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(60)
        shown = snapshot(rig.daemon.view(rig.now_us))
    assert "last known" not in dict(rows(shown))
    assert shown["last_known"]["mass_kg"] == shown["estimate"]["mass_kg"]


def test_the_monitor_keeps_the_last_mass_when_the_broadcast_has_none():
    view = LiveView(PGN, "canest")
    assert view.take(CAN_ID, encode(Estimate(20600.0, 200.0, 0.03, 0.001, 2, 0), 0, CAN_ID), 100.0)
    assert "known" not in view.line(100.0)
    assert view.take(CAN_ID, encode(Estimate(), 1, CAN_ID), 140.0)
    assert "- (last 20,600 kg 42 s ago)" in view.line(142.0)


@pytest.mark.parametrize(("seconds", "text"), [(35.2, "35 s"), (720, "12 min"), (12600, "3.5 h")])
def test_an_age_is_shown_in_the_units_people_use(seconds, text):
    assert age(seconds) == text
