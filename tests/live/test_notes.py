"""What contradicts the config is said while the daemon runs, as a check of a log says it afterwards."""

from __future__ import annotations

import re
import socket

import pytest

from canest.core.errors import UsageError
from canest.live.daemon import Daemon
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from canest.telemetry.snapshot import snapshot
from canest.telemetry.status_view import rows
from tests.live.rig import Rig, config


def without_numbers(texts):
    return [re.sub(r"\d[\d.,]*", "#", text) for text in texts]


def is_answered(rig, path):
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(str(path))
        rig.run(2)
        return b"uptime_s" in client.recv(1 << 20)


def test_a_wrong_wheel_radius_is_named_by_status_and_journal_once(tmp_path, drive, monkeypatch):
    wrong = config(tmp_path, "vehicle.wheel_radius_m=0.55", name="class8")
    with Rig(monkeypatch, wrong, drive) as rig:
        rig.run(30)
        assert snapshot(rig.daemon.view(rig.now_us))["notes"] == []
        rig.run(58)
        content = snapshot(rig.daemon.view(rig.now_us))
        assert any("wheel_radius_m 0.500 " in note for note in content["notes"])
        assert [text for label, text in rows(content) if label == "note"] == content["notes"]
        rig.script.repeat(rig.now_us)
        rig.run(80)
        assert rig.log.getvalue().count("notes now=") == 1


def test_a_right_config_has_the_notes_of_a_replay(tmp_path, drive, monkeypatch):
    found = replay(FrameLog(drive), config(tmp_path, name="class8"))
    with Rig(monkeypatch, config(tmp_path, name="class8"), drive) as rig:
        rig.run(89)
        notes = snapshot(rig.daemon.view(rig.now_us))["notes"]
    assert set(without_numbers(notes)) <= set(without_numbers(found.warnings))


def test_another_config_is_compared_anew(tmp_path, drive, monkeypatch):
    changes = ["vehicle.wheel_radius_m=0.55"]

    def settings():
        return config(tmp_path, *changes, name="class8")

    with Rig(monkeypatch, settings(), drive, reload=settings) as rig:
        rig.run(70)
        assert rig.daemon.estimation.notes.found
        changes.clear()
        rig.daemon.request_reload()
        rig.run(2)
        assert not rig.daemon.estimation.notes.found
        rig.script.repeat(rig.now_us)
        rig.run(75)
        assert not any("wheel_radius_m" in note for note in rig.daemon.estimation.notes.found)


def test_a_defect_in_a_check_is_survived(tmp_path, drive, monkeypatch):
    def broken(samples):
        raise ZeroDivisionError("surprise")

    with Rig(monkeypatch, config(tmp_path, name="class8"), drive) as rig:
        rig.daemon.estimation.notes._check.push = broken
        rig.run(60)
        assert "notes-failed" in rig.log.getvalue()
        assert rig.daemon.estimate(rig.now_us).mass_kg > 0.0


def test_a_daemon_that_is_refused_leaves_the_state_file_of_the_one_that_runs(tmp_path, drive, monkeypatch):
    """Of another vehicle it would have been set aside."""
    with Rig(monkeypatch, config(tmp_path, "service.learn='on+save'"), drive) as rig:
        rig.daemon.reporter.open(rig.daemon.config)
        rig.run(60)
        rig.daemon.estimation.mass_store.save()
        rig.daemon.background.close(5.0)
        before = {path.name: path.read_bytes() for path in tmp_path.glob("learned-*")}
        assert before
        other = config(tmp_path, "service.learn='on+save'", "vehicle.name=truck-2")
        with pytest.raises(UsageError, match="running already"):
            Daemon(other)
        assert {path.name: path.read_bytes() for path in tmp_path.glob("learned-*")} == before


def test_a_status_socket_that_somebody_deletes_is_there_again(tmp_path, drive, monkeypatch):
    with Rig(monkeypatch, config(tmp_path), drive) as rig:
        rig.daemon.reporter.open(rig.daemon.config)
        rig.run(2)
        path = rig.daemon.reporter.endpoints.status.path
        for name in tmp_path.glob("*.sock"):
            name.unlink()
        rig.run(2)
        assert "status-socket-lost" in rig.log.getvalue()
        assert len(list(tmp_path.glob("*.sock"))) == 2
        assert is_answered(rig, path)
