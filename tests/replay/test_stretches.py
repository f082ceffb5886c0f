"""A block of slow signals may be hours of ticks: it is taken in stretches, and no bit changes."""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config
from canest.core.columns import stretches
from canest.core.estimates import Estimates
from canest.offline import log_run
from canest.offline.log_run import LogRun

ZTBUS = Path(__file__).parents[1] / "data" / "ztbus" / "three-loads.csv.xz"
CONFIG = """
vehicle: {name: bus, mass_min_kg: 18000, mass_max_kg: 33000, wheel_radius_m: 1.0, wheel_inertia_kgm2: 0,
  gear_ratios: {1: 1.0}, final_drive: 1.0, driveline_efficiency: 1.0, engine_inertia_kgm2: 0,
  drag_area_m2: 5.5, rolling_resistance: 0.008}
dbc: []
sampling: {time_column: time_unix}
signals:
  wheel_torque: {column: traction_tractionForce, unit: Nm, stale_s: 1.5}
  vehicle_speed: {column: odometry_vehicleSpeed, unit: m/s, stale_s: 1.5}
"""


def estimates(log: Path, config: Path) -> list[Estimates]:
    return list(LogRun(log, load_config(str(config))).estimates())


def test_half_an_hour_at_1_hz_comes_in_stretches_of_the_same_bits(tmp_path, monkeypatch):
    log, config = tmp_path / "bus.csv", tmp_path / "bus.yaml"
    log.write_bytes(lzma.decompress(ZTBUS.read_bytes()))
    config.write_text(CONFIG)
    parts = estimates(log, config)
    assert len(parts) >= 3
    assert max(map(len, parts)) <= 30_001
    monkeypatch.setattr(log_run, "STRETCH_US", 10**15)
    whole = estimates(log, config)
    assert max(map(len, whole)) > 90_000
    for name in Estimates.__slots__:
        columns = [np.concatenate([getattr(part, name) for part in run]) for run in (parts, whole)]
        assert np.array_equal(*columns, equal_nan=columns[0].dtype.kind == "f")


@pytest.mark.parametrize(
    ("stamps", "lengths"),
    [
        ([], [0]),
        ([5], [1]),
        ([0, 4, 9], [3]),
        ([0, 4, 10, 19, 20], [2, 2, 1]),
        ([0, 35, 36, 70], [1, 2, 1]),
        ([100, 50, 0, 105], [4]),  # set back
        ([0, 500, 1, 2, 501], [1, 4]),  # one stamp from the future
    ],
)
def test_stretches_cover_a_column_in_order(stamps, lengths):
    t_us = np.array(stamps, np.int64)
    parts = [t_us[part] for part in stretches(t_us, 10)]
    assert [len(part) for part in parts] == lengths
    assert np.array_equal(np.concatenate(parts), t_us)
