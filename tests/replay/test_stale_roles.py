"""A stale signal is named, by replay and by check: its gate alone says nothing of which it is."""

import numpy as np
import pytest

import canest
from canest.cli.main import run

CONFIG = """
vehicle: {name: car, mass_min_kg: 1000, mass_max_kg: 2500, wheel_radius_m: 0.3, gear_ratios: {1: 9.0},
  final_drive: 1.0, drag_area_m2: 0.7, rolling_resistance: 0.01}
dbc: []
signals:
  engine_torque: {column: torque, unit: Nm, stale_s: 0.5}
  vehicle_speed: {column: speed, unit: m/s, stale_s: 0.5}
  altitude: {column: height, unit: m}
"""


@pytest.fixture
def drive(tmp_path):
    """Return a table and its config: the torque falls silent for ten of forty seconds."""
    t = np.arange(0, 40, 0.02)
    path = tmp_path / "drive.csv"
    rows = [
        f"{s:.2f},{'' if 10 < s < 20.5 else 80},{10 + s / 10:.3f},{'' if s > 5 else 400}" for s in t.tolist()
    ]
    path.write_text("t_s,torque,speed,height\n" + "\n".join(rows) + "\n")
    (tmp_path / "car.yaml").write_text(CONFIG)
    return path, tmp_path / "car.yaml"


def test_replay_names_the_role_that_is_stale(drive):
    path, config = drive
    signals = canest.load_config(config)
    frames = path.read_text().splitlines()
    silent = [line for line in frames if ",,1" not in line]  # no row at all while the torque is silent
    path.write_text("\n".join(silent) + "\n")
    result = canest.replay(path, signals)
    stale = result.summary["stale_roles"]
    assert set(stale) == {"engine_torque", "vehicle_speed"}  # both columns of the rows that are missing
    notes = [note for note in result.summary["notes"] if "stale" in note]
    assert len(notes) == 2 and "a value counts for 0.5 s (signals.engine_torque.stale_s)" in "".join(notes)


def test_a_role_that_nothing_needs_is_not_named(drive):
    path, config = drive
    assert "altitude" not in canest.replay(path, config).summary["stale_roles"]


def test_check_names_it_too(drive, capsys):
    path, config = drive
    path.write_text("\n".join(line for line in path.read_text().splitlines() if ",,1" not in line) + "\n")
    run(["check", "-c", str(config), str(path)])
    assert "engine_torque was stale for" in capsys.readouterr().out


def test_a_drive_without_silence_has_no_such_note():
    drive = canest.demo_drive()
    notes = canest.replay(drive, drive.config).summary["notes"]
    assert not any("stale" in note for note in notes)
