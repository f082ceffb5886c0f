"""The life of a daemon: defects, what it learned, reloads, its end."""

from __future__ import annotations

import json
import shutil
import time

import numpy as np
import pytest

from canest.core.errors import ConfigError
from canest.core.frames import FrameBlock
from canest.core.samples import Status
from canest.live.estimation import MOST_FAILURES_IN_A_ROW
from canest.live.reload import LONGEST_S
from canest.pipeline.pipeline import Pipeline
from canest.system.shipped_files import shipped
from canest.telemetry import metrics
from canest.telemetry.snapshot import snapshot
from canest.telemetry.status_view import rows
from tests.live.conftest import ODOMETER_START_KM, VDHR_ID
from tests.live.rig import Rig, config, descriptors, resident_kb, wait_for


def test_a_defect_in_the_estimation_is_survived_with_the_learned_mass(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path, "service.learn='on'"), drive) as rig:
        rig.run(60)
        before = rig.daemon.estimate(rig.now_us)

        def broken(frames):
            raise ZeroDivisionError("surprise")

        rig.daemon.pipeline.push = broken
        rig.run(5)
        assert rig.daemon.estimation.failures == 1
        assert "ZeroDivisionError" in rig.log.getvalue()
        after = rig.daemon.estimate(rig.now_us)
        assert abs(after.mass_kg - before.mass_kg) < 0.02 * before.mass_kg


def test_a_defect_is_survived_while_the_dbc_is_gone_and_a_reload_of_it_refused(tmp_path, drive, monkeypatch):
    """Somebody copies a new one there: for a moment there is none, or half of it."""
    dbc = tmp_path / "own.dbc"
    shutil.copy(shipped("dbc") / "j1939.dbc", dbc)

    def settings():
        return config(tmp_path, f"dbc=[{dbc}]", "service.learn='on'")

    def broken(frames):
        raise ZeroDivisionError("surprise")

    with Rig(monkeypatch, settings(), drive, reload=settings) as rig:
        rig.run(60)
        before = rig.daemon.estimate(rig.now_us)
        dbc.unlink()
        rig.daemon.pipeline.push = broken
        rig.run(3)
        rig.daemon.request_reload()
        rig.run(2)
        assert rig.daemon.estimation.failures == 1 and rig.daemon.reloads.accepted == 0
        refused = next(line for line in rig.log.getvalue().splitlines() if "reload-refused" in line)
        assert "own.dbc" in refused
        after = rig.daemon.estimate(rig.now_us)
        assert abs(after.mass_kg - before.mass_kg) < 0.02 * before.mass_kg


def test_a_defect_that_stays_ends_the_daemon_for_systemd_to_restart_it(tmp_path, drive, monkeypatch):
    def broken(self, frames):
        raise ZeroDivisionError("surprise")

    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        monkeypatch.setattr(Pipeline, "push", broken)
        with pytest.raises(ZeroDivisionError):
            rig.run(5)
        assert rig.daemon.estimation.failures == MOST_FAILURES_IN_A_ROW


def test_a_mass_learned_survives_a_restart_with_more_variance(tmp_path, drive, monkeypatch):
    settings = config(tmp_path, "service.learn='on+save'")
    with Rig(monkeypatch, settings, drive) as rig:
        rig.run(80)
        learned = rig.daemon.estimate(rig.now_us)
    saved = json.loads((tmp_path / "learned-vcan0.json").read_text())
    assert abs(saved["mass_kg"] - learned.mass_kg) < 100 and saved["valid"] is True
    assert saved["distance_km"] == rig.daemon.node.monitor.distance_km is not None
    assert 0.5 < saved["distance_km"] - ODOMETER_START_KM < 3.0
    with Rig(monkeypatch, settings, drive) as rig:
        assert "mass-restored" in rig.log.getvalue()
        rig.run(3)
        restored = rig.daemon.estimate(rig.now_us)
        assert abs(restored.mass_kg - learned.mass_kg) < 0.02 * learned.mass_kg
        assert restored.mass_std_kg > learned.mass_std_kg


def test_the_distance_of_a_random_sender_is_not_stored(tmp_path, drive, monkeypatch):
    noise = np.random.default_rng(1).integers(0, 2**64, len(drive), dtype=np.uint64)
    data = np.where(drive.can_id == np.uint32(VDHR_ID), noise, drive.data)
    frames = FrameBlock(drive.t_us, drive.can_id, drive.length, data)
    with Rig(monkeypatch, config(tmp_path, "service.learn='on+save'"), frames) as rig:
        rig.run(80)
    saved = json.loads((tmp_path / "learned-vcan0.json").read_text())
    assert saved["distance_km"] is None


@pytest.mark.parametrize("learn", ["'off'", "'on'"])
def test_learning_switched_off_writes_nothing(tmp_path, drive, monkeypatch, learn):
    with Rig(monkeypatch, config(tmp_path, f"service.learn={learn}"), drive) as rig:
        rig.run(60)
    assert not (tmp_path / "learned-vcan0.json").exists()


def test_an_unusable_state_file_is_reported_and_set_aside(tmp_path, monkeypatch):
    (tmp_path / "learned-vcan0.json").write_text("half a fi")
    with Rig(monkeypatch, config(tmp_path, "service.learn='on+save'")) as rig:
        assert "state-not-used" in rig.log.getvalue()
    assert (tmp_path / "learned-vcan0.json.bad-corrupt").exists()


def test_a_state_directory_that_cannot_be_written_is_reported_once_and_counted(tmp_path, drive, monkeypatch):
    (tmp_path / "occupied").write_text("")
    settings = config(tmp_path, "service.learn='on+save'", f"service.state_dir={tmp_path}/occupied/x",
                      "service.save_every_s=2")  # fmt: skip
    with Rig(monkeypatch, settings, drive) as rig:
        rig.run(60)
        rig.daemon.background.flush(5)
        rig.run(5)
        assert rig.daemon.background.counters["state_failed"] > 3
        assert rig.log.getvalue().count("writing-state") == 1
        assert rig.daemon.estimate(rig.now_us).status == Status.VALID


def test_reload_takes_a_changed_config_over_and_keeps_the_learned_mass(tmp_path, drive, monkeypatch):
    settings = config(tmp_path, "service.learn='on+save'")
    changed = config(tmp_path, "service.learn='on+save'", "vehicle.rolling_resistance=0.0061")
    with Rig(monkeypatch, settings, drive, reload=lambda: changed) as rig:
        rig.run(60)
        before = rig.daemon.estimate(rig.now_us)
        rig.daemon.request_reload()
        rig.run(5)
        assert rig.daemon.config is changed and rig.daemon.reloads.accepted == 1
        assert len(rig.opened) == 1  # same bus: not closed, no frame missed
        assert abs(rig.daemon.estimate(rig.now_us).mass_kg - before.mass_kg) < 0.03 * before.mass_kg


def test_reload_of_what_the_estimate_does_not_depend_on_leaves_it_alone(tmp_path, drive, monkeypatch):
    settings = config(tmp_path, "service.learn='on+save'")
    changed = config(tmp_path, "service.learn='on+save'", "service.save_every_s=77")
    with Rig(monkeypatch, settings, drive, reload=lambda: changed) as rig:
        rig.run(60)
        pipeline, before = rig.daemon.pipeline, rig.daemon.estimate(rig.now_us)
        assert before.status == Status.VALID
        rig.daemon.request_reload()
        rig.run(2)
        assert rig.daemon.config is changed and rig.daemon.reloads.accepted == 1
        assert rig.daemon.pipeline is pipeline
        assert rig.daemon.estimate(rig.now_us).status == Status.VALID
        assert "mass-restored" not in rig.log.getvalue()
        assert rig.daemon.estimation.mass_store.learned is not None


def test_reload_takes_an_edited_dbc_over_and_refuses_a_broken_one(tmp_path, drive, monkeypatch):
    dbc = tmp_path / "own.dbc"
    shutil.copy(shipped("dbc") / "j1939.dbc", dbc)

    def settings():
        return config(tmp_path, f"dbc=[{dbc}]")

    def edited(rig, text):
        dbc.write_text(text)
        rig.daemon.request_reload()
        pipeline = rig.daemon.pipeline
        rig.run(2)
        return rig.daemon.pipeline is not pipeline

    text = dbc.read_text()
    with Rig(monkeypatch, settings(), drive, reload=settings) as rig:
        rig.run(1)
        assert not edited(rig, text[: len(text) // 2].rsplit("BO_", 1)[0] + "BO_ nonsense")
        assert "reload-refused" in rig.log.getvalue()
        assert not edited(rig, text)  # the old one put back, or copied there again, changes nothing
        assert rig.daemon.reloads.accepted == 1
        assert edited(rig, text + "\n")
        assert len(rig.opened) == 2  # filters may have changed with it
        rig.daemon.request_reload()
        pipeline = rig.daemon.pipeline
        rig.run(2)
        assert rig.daemon.pipeline is pipeline and rig.daemon.reloads.accepted == 3


@pytest.mark.parametrize(
    "error", [ConfigError("unknown key", where="truck.yaml:3"), RecursionError("truck.yaml:3 too deep")]
)
def test_reload_refuses_a_broken_config_and_goes_on(tmp_path, drive, monkeypatch, error):
    def broken():
        raise error

    with Rig(monkeypatch, config(tmp_path), drive, reload=broken) as rig:
        rig.run(40)
        pipeline = rig.daemon.pipeline
        rig.daemon.request_reload()
        rig.run(2)
        assert rig.daemon.pipeline is pipeline
        assert "reload-refused" in rig.log.getvalue() and "truck.yaml:3" in rig.log.getvalue()


def test_reload_onto_another_bus_joins_it(tmp_path, drive, monkeypatch):
    other = config(tmp_path, "bus.channel=vcan7")
    with Rig(monkeypatch, config(tmp_path), drive, reload=lambda: other) as rig:
        rig.run(1)
        rig.daemon.request_reload()
        rig.run(2)
        assert [bus.channel for bus, _ in rig.opened] == ["vcan0", "vcan7"]


def test_stopping_takes_no_longer_than_a_second_even_with_a_disk_that_hangs(tmp_path, drive, monkeypatch):
    import threading

    release = threading.Event()
    rig = Rig(monkeypatch, config(tmp_path, "service.learn='on+save'"), drive)
    rig.run(40)
    rig.daemon.background.submit("hang", release.wait)
    begin = time.perf_counter()
    rig.daemon.close()
    assert time.perf_counter() - begin < 1.0
    assert "disk-hangs" in rig.log.getvalue()
    release.set()


@pytest.mark.slow
def test_a_quarter_of_an_hour_of_driving_leaves_nothing_behind(tmp_path, drive, monkeypatch):
    ring = tmp_path / "ring"
    settings = config(tmp_path, "service.learn='on+save'", f"service.residual_dir={ring}",
                      f"service.metrics_file={tmp_path}/m.prom", "service.residual_max_mb=2")  # fmt: skip
    with Rig(monkeypatch, settings, drive) as rig:
        before = None
        for minute in range(0, 16, 2):
            rig.script.repeat(rig.now_us)
            rig.run(120)
            rig.daemon.background.flush(10)
            if minute == 6:
                before = resident_kb(), descriptors(ring)
        assert descriptors(ring) <= before[1]
        assert resident_kb() - before[0] < 2048
        assert rig.daemon.estimation.failures == 0


def test_the_loop_goes_on_while_a_config_is_read_and_a_second_signal_waits_for_its_turn(
    tmp_path, drive, monkeypatch
):
    import threading

    settings = config(tmp_path)
    changed = config(tmp_path, "service.save_every_s=77")
    go_on, reading = threading.Event(), []

    def slow():
        reading.append(threading.current_thread())
        go_on.wait(30)
        return changed

    with Rig(monkeypatch, settings, drive, reload=slow) as rig:
        rig.waits_for_reload = False
        rig.run(1)
        rig.daemon.request_reload()
        rig.run(10)
        assert wait_for(lambda: len(reading) == 1) and reading[0] is not threading.current_thread()
        frames = rig.daemon.pipeline.decoder.counters.frames
        for _ in range(3):
            rig.daemon.request_reload()
            rig.run(5)
        assert len(reading) == 1 and rig.daemon.config is settings
        assert rig.daemon.pipeline.decoder.counters.frames > frames
        go_on.set()
        rig.waits_for_reload = True
        rig.run(3)
        assert rig.daemon.config is changed
        assert rig.daemon.reloads.accepted == 2 == len(reading)


def test_a_config_that_cannot_be_read_in_time_is_refused_and_the_old_one_stays(tmp_path, drive, monkeypatch):
    """Its file may lie on a disk that is gone."""
    import threading

    settings = config(tmp_path)
    release = threading.Event()

    def hangs():
        release.wait(30)
        return config(tmp_path, "service.save_every_s=77")

    with Rig(monkeypatch, settings, drive, reload=hangs) as rig:
        rig.waits_for_reload = False
        rig.daemon.request_reload()
        rig.run(LONGEST_S + 3)
        assert rig.daemon.reloads.refused == 1
        assert "could not be read within" in snapshot(rig.daemon.view(rig.now_us))["reload_refused_because"]
        rig.daemon.request_reload()
        rig.run(2)
        assert "still being read" in snapshot(rig.daemon.view(rig.now_us))["reload_refused_because"]
        release.set()
        assert wait_for(lambda: not any(t.name == "canest-reload" for t in threading.enumerate()))
        assert rig.daemon.config is settings
        rig.daemon.request_reload()
        rig.waits_for_reload = True
        rig.run(2)
        assert rig.daemon.reloads.accepted == 1 and rig.daemon.config is not settings


def test_a_refused_reload_counts_in_status_and_metrics_until_one_is_taken(tmp_path, drive, monkeypatch):
    read = [ConfigError("unknown key", where="truck.yaml:3"), config(tmp_path)]

    def reload():
        following = read.pop(0)
        if isinstance(following, Exception):
            raise following
        return following

    with Rig(monkeypatch, config(tmp_path), drive, reload=reload) as rig:
        rig.daemon.request_reload()
        rig.run(2)
        shown = snapshot(rig.daemon.view(rig.now_us))
        assert shown["reloads"] == 0 and shown["reloads_refused"] == 1
        assert shown["reload_refused_because"] == "truck.yaml:3: unknown key"
        assert any("truck.yaml:3: unknown key" in line for _, line in rows(shown))
        assert "canest_reloads_refused_total 1" in metrics.text(shown)
        rig.daemon.request_reload()
        rig.run(2)
        shown = snapshot(rig.daemon.view(rig.now_us))
        assert shown["reloads"] == 1 == shown["reloads_refused"] and not shown["reload_refused_because"]
        assert not any("truck.yaml:3" in line for _, line in rows(shown))
        assert "canest_reloads_total 1" in metrics.text(shown)
