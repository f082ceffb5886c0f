"""A file of estimates never replaces what they were made from, as on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

import canest

VAN = canest.Vehicle(
    mass_min_kg=2000, mass_max_kg=3500, wheel_radius_m=0.34, final_drive=3.9, drag_area_m2=1.2,
    rolling_resistance=0.009,
)  # fmt: skip
CONFIG = """
vehicle: {mass_min_kg: 2000, mass_max_kg: 3500, wheel_radius_m: 0.34, final_drive: 3.9, drag_area_m2: 1.2,
          rolling_resistance: 0.009}
dbc: []
signals: {wheel_torque: {column: torque}, vehicle_speed: {column: speed}}
"""
LOG = "t_s,torque,speed\n" + "".join(f"{i / 50:.2f},100,10\n" for i in range(100))
TABLE = {"t_s": [0.0, 0.02], "wheel_torque": [100.0, 100.0], "vehicle_speed": [10.0, 10.0]}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with a log, its truth and a config, where the test is."""
    monkeypatch.chdir(tmp_path)
    Path("drive.csv").write_text(LOG)
    Path("truth.csv").write_text("t_s,mass_kg\n0,3000\n2,3000\n")
    Path("my.yaml").write_text(CONFIG)
    return tmp_path


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("output", "text"),
    [
        ("drive.csv", "output: would overwrite the log drive.csv, found 'drive.csv', expected another name"),
        ("truth.csv", "output: would overwrite the truth truth.csv"),
        ("my.yaml", "output: would overwrite the config"),
        ("est.xlsx", "output: no format of estimates, found 'est.xlsx', expected a name that ends in .csv"),
    ],
)
def test_replay_overwrites_no_input(folder, output, text):
    before = content(folder)
    loaded = canest.load_config("my.yaml")
    for config in ("my.yaml", loaded, canest.load_config(folder / "my.yaml")):
        with pytest.raises(canest.UsageError, match=text):
            canest.replay("drive.csv", config, truth="truth.csv", output=output)
    assert content(folder) == before


def test_replay_knows_an_input_by_another_name(folder):
    Path("link.csv").symlink_to("drive.csv")
    before = content(folder)
    for output in (folder / "drive.csv", "link.csv", "./drive.csv"):
        with pytest.raises(canest.UsageError, match="would overwrite the log"):
            canest.replay("drive.csv", "my.yaml", output=output)
    assert content(folder) == before


@pytest.mark.parametrize("config", ["my.yaml", VAN])
def test_estimate_overwrites_no_input(folder, config):
    before = content(folder)
    for output in ["truth.csv", "est.xlsx"] + (["my.yaml"] if config == "my.yaml" else []):
        with pytest.raises(canest.UsageError, match="output: "):
            canest.estimate(TABLE, config, truth="truth.csv", output=output)
    assert content(folder) == before


def test_estimates_are_written_in_the_format_of_their_name(folder):
    canest.replay("drive.csv", "my.yaml", output="est.csv")
    canest.replay("drive.csv", "my.yaml", output="est.log")
    assert Path("est.csv").read_text().startswith("t_s,mass_kg")
    assert Path("est.log").read_text().startswith("(")
    canest.estimate(TABLE, VAN, output="van.log")
    assert Path("van.log").read_text().startswith("(")


@pytest.mark.parametrize("output", [3, "", b""])
def test_what_is_no_path_is_no_output(folder, output):
    with pytest.raises(canest.UsageError, match="output: no path"):
        canest.replay("drive.csv", "my.yaml", output=output)
