"""The example effect as a user meets it: installed, found in a drive, used, broken, and gone again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from example_helpers import ROOT, install

EXAMPLE = ROOT / "examples" / "canest-trailer-drag"
MASS_KG, TRAILER_M2, SECONDS = 1500.0, 3.0, 240
CONFIG = """
vehicle:
  name: van
  mass_min_kg: 800
  mass_max_kg: 4000
  wheel_radius_m: 0.3
  wheel_inertia_kgm2: 0.0
  final_drive: 1.0
  gear_ratios: {1: 10.0}
  driveline_efficiency: 1.0
  engine_inertia_kgm2: 0.0
  drag_area_m2: 2.5
  air_density_kgpm3: 1.2
  rolling_resistance: 0.01
dbc: []
signals:
  engine_torque: {column: torque_Nm, unit: Nm}
  vehicle_speed: {column: v_mps, unit: m/s}
  trailer_attached: {column: trailer}
"""
EFFECT = "effects: [{effect: trailer_drag, cda_delta_m2: 3.0}]\n"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a drive with pulses of torque on the level; the trailer comes and goes every minute."""
    t_s = 0.02 * np.arange(50 * SECONDS)
    torque_Nm = 55.0 + 45.0 * np.sign(np.sin(t_s * 0.7))
    trailer = (t_s // 60) % 2
    v_mps = np.empty(len(t_s))
    v = 20.0
    for k in range(len(t_s)):
        v_mps[k] = v
        force_N = torque_Nm[k] * 10.0 / 0.3 - 0.6 * (2.5 + TRAILER_M2 * trailer[k]) * v**2
        v += 0.02 * (force_N / MASS_KG - 0.01 * 9.80665)
    log = tmp_path_factory.mktemp("trailer") / "drive.csv"
    columns = np.column_stack((t_s, torque_Nm, v_mps, trailer))
    np.savetxt(log, columns, "%.6f", ",", header="t_s,torque_Nm,v_mps,trailer", comments="")
    truth = np.column_stack((t_s, np.full(len(t_s), MASS_KG), np.zeros(len(t_s))))
    np.savetxt(log.with_suffix(".truth.csv"), truth, "%.3f", ",", header="t_s,mass_kg,grade", comments="")
    log.with_suffix(".yaml").write_text(CONFIG)
    log.with_name("with.yaml").write_text(CONFIG + EFFECT)
    for whole in (log, log.with_suffix(".truth.csv")):  # a minute of it, without the trailer
        lines = whole.read_text().splitlines(keepends=True)
        whole.with_name(whole.name.replace("drive", "minute")).write_text("".join(lines[:3000]))
    return log


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("installed")
    install(EXAMPLE, target)
    return target


@pytest.mark.slow
def test_the_diagnosis_finds_it_and_the_revised_config_repairs_the_replay(
    canest_with, installed, drive, tmp_path
):
    out = tmp_path / "found"
    done = canest_with(installed, "diagnose", drive, "-c", drive.with_suffix(".yaml"), "--truth", "auto",
                       "-o", out)  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads((out / "diagnosis.json").read_text("utf-8"))
    assert found["selected"] == ["trailer_drag"] and found["verdict"] == "explained"
    value = found["candidates"][0]["parameters"]["cda_delta_m2"]["value"]
    assert value == pytest.approx(TRAILER_M2, rel=0.05)
    assert "larger while a trailer is attached" in " ".join(found["details"])
    errors = {}
    for config in (drive.with_suffix(".yaml"), out / "revised.yaml"):
        summary = tmp_path / f"{config.stem}.json"
        done = canest_with(installed, "replay", drive, "-c", config, "--truth", "auto", "--json", summary)
        assert done.returncode == 0, done.stderr
        errors[config.stem] = json.loads(summary.read_text())["errors"]
    assert errors["revised"]["mass_rms_pct"] < 2.0
    assert errors["revised"]["grade_rms_deg"] < 0.5 * errors["drive"]["grade_rms_deg"]


def test_check_takes_a_config_that_uses_it(canest_with, installed, drive):
    done = canest_with(installed, "check", "-c", drive.with_name("with.yaml"), drive)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "trailer_attached" in done.stdout


@pytest.mark.parametrize("command", ["check", "replay", "diagnose"])
def test_a_config_that_uses_it_where_it_is_not_installed_is_refused_in_one_line(
    canest_with, drive, tmp_path, command
):
    output = ["-o", tmp_path / "out"] if command != "check" else []
    done = canest_with(tmp_path, command, drive, "-c", drive.with_name("with.yaml"), *output)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and "unknown effect" in done.stderr and "trailer_drag" in done.stderr


def test_a_package_that_cannot_be_imported_is_named_and_skipped(canest_with, drive, tmp_path):
    broken, minute = tmp_path / "broken", drive.with_name("minute.csv")
    install(EXAMPLE, broken)
    (broken / "canest_trailer_drag" / "__init__.py").write_text("import no_such_library\n")
    plain = tmp_path / "plain.yaml"
    plain.write_text(CONFIG.replace("  trailer_attached: {column: trailer}\n", ""))
    done = canest_with(broken, "diagnose", minute, "-c", plain, "--truth", "auto", "-o", tmp_path / "found")
    assert done.returncode == 0, done.stderr
    reason = "No module named 'no_such_library'"
    assert "trailer_drag" in done.stdout and reason in done.stdout
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text("utf-8"))
    assert reason in found["not_tried"]["trailer_drag"]
    done = canest_with(broken, "replay", minute, "-c", plain, "-o", tmp_path / "est.csv")
    assert done.returncode == 0 and "trailer_drag" not in done.stdout + done.stderr
    done = canest_with(broken, "replay", minute, "-c", drive.with_name("with.yaml"), "-o", tmp_path / "e.csv")
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "trailer_drag cannot be used" in done.stderr and reason in done.stderr
