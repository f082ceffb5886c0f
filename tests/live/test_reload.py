"""A reload: what has changed is in force at once, and what a start would refuse is not carried over."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canest.core.samples import Status
from canest.decode import j1939
from canest.node.address_claim import CLAIM_PGN
from canest.road.build import build_map
from canest.road.table import write_map
from canest.telemetry.metrics import text
from canest.telemetry.snapshot import flat, snapshot
from tests.live.rig import Rig, config
from tests.road.conftest import drive as road_drive


@pytest.mark.parametrize("changes", [("service.learn='off'",), ("vehicle.mass_max_kg=15000",)])
def test_a_reload_carries_no_mass_over_that_a_start_would_refuse(tmp_path, drive, monkeypatch, changes):
    # the other radius makes the estimate begin anew
    changed = config(tmp_path, "vehicle.wheel_radius_m=0.51", *changes)
    with Rig(monkeypatch, config(tmp_path), drive, reload=lambda: changed) as rig:
        rig.run(60)
        assert rig.daemon.estimate(rig.now_us).status == Status.VALID
        rig.daemon.request_reload()
        rig.run(2)
        assert rig.daemon.config is changed
        assert "mass-restored" not in rig.log.getvalue()
        assert rig.daemon.estimate(rig.now_us).status != Status.VALID


def test_a_reload_takes_another_road_map_over(tmp_path, drive, monkeypatch):
    path = tmp_path / "road.parquet"
    road = build_map([road_drive(0), road_drive(1, "b")])
    path.write_bytes(write_map(road))

    def settings():
        return config(tmp_path, f"road_map={path}")

    with Rig(monkeypatch, settings(), drive, reload=settings) as rig:
        rig.run(1)
        pipelines = [rig.daemon.pipeline]
        seen = snapshot(rig.daemon.view(rig.now_us))
        assert seen["road_ahead"] == {"distance_m": [], "grade": []}  # it is on no road of the map
        assert "road_ahead" not in text(seen) and "road_ahead" not in flat(seen)
        for content in (road, replace(road, grade=road.grade + 0.01)):
            path.write_bytes(write_map(content))
            rig.daemon.request_reload()
            rig.run(1)
            pipelines.append(rig.daemon.pipeline)
    assert pipelines[0] is pipelines[1]  # the same content: nothing begins anew
    assert pipelines[1] is not pipelines[2]


def test_a_reload_of_the_rate_keeps_the_interface_and_every_frame(tmp_path, drive, monkeypatch):
    changed = config(tmp_path, "broadcast.rate_hz=2")
    with Rig(monkeypatch, config(tmp_path), drive, reload=lambda: changed) as rig:
        rig.run(10)
        rig.daemon.request_reload()
        rig.run(10)
        assert rig.daemon.config is changed and len(rig.opened) == 1
        assert rig.script.dropped_waiting == 1  # they were of the old node
        received = rig.daemon.pipeline.decoder.counters.frames
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(20)
        assert rig.daemon.pipeline.decoder.counters.frames == received


def test_an_interface_that_was_down_is_joined_anew(tmp_path, drive, monkeypatch):
    """Claims of others were missed meanwhile."""
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(5)
        assert rig.daemon.node.address is not None
        rig.script.state = "down"
        rig.run(5)
        rig.script.state = "up"
        rig.script.sent.clear()
        rig.run(2)
        groups = [j1939.pgn_of(can_id) for _, can_id, _ in rig.script.sent]
        assert groups[0] == CLAIM_PGN and set(groups[1:]) == {0xFF5A}
        claimed_ns, first_ns = (rig.script.sent[k][0] for k in (0, 1))
        assert first_ns - claimed_ns >= 250_000


def test_a_controller_that_was_bus_off_repeats_its_claim_and_goes_on(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.run(5)
        rig.script.state = "bus-off"
        rig.run(0.5)
        rig.script.state = "up"
        rig.script.sent.clear()
        rig.run(1)
        groups = [j1939.pgn_of(can_id) for _, can_id, _ in rig.script.sent]
        assert groups.count(CLAIM_PGN) == 1 and groups.count(0xFF5A) >= 4
