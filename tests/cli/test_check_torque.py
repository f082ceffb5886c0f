"""The doctor on torques that are none: what is a fault of the sender, and what of the config."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import load_config, parse_config, read_databases
from canest.core.frames import FrameBlock
from canest.doctor.check import Doctor
from canest.doctor.torque_samples import TorqueSampleCheck

DBC = """VERSION ""
BU_: E
BO_ 288 Engine: 4 E
 SG_ Torque : 0|16@1- (0.1,0) [-1000|2000] "Nm" E
 SG_ Rpm : 16|16@1+ (0.25,0) [0|8000] "rpm" E
BO_ 304 Motion: 3 E
 SG_ Speed : 0|16@1+ (0.01,0) [0|300] "km/h" E
 SG_ Brake : 16|1@1+ (1,0) [0|1] "" E
"""
CONFIG = """
vehicle:
  {mass_min_kg: 3500, mass_max_kg: 12000, wheel_radius_m: 0.39, final_drive: 3.9, drag_area_m2: 3.9,
   rolling_resistance: 0.0085}
dbc: [%s]
signals:
  engine_torque: {message: Engine, signal: Torque%s}
  engine_speed: {message: Engine, signal: Rpm}
  vehicle_speed: {message: Motion, signal: Speed}
  brake_switch: {message: Motion, signal: Brake}
"""


def samples_of(values, cut=1000, role="engine_torque", where="bmw-i3"):
    """Return what is said of a torque that reads these values (n,), 50 times a second."""
    config = load_config(where)
    source = next(iter(config.signals.values()))
    judge = TorqueSampleCheck(config.model_copy(update={"signals": {role: source}}))
    t_us = np.arange(len(values), dtype=np.int64) * 20_000
    for first in range(0, len(values), cut):
        judge.push({role: (t_us[first : first + cut], values[first : first + cut])})
    return judge.hints()


def noisy(n=20_000, std=20.0, scale=1.0):
    """Return a torque in N m with white noise, as coarse as a bus makes it (n,)."""
    torque = 380 + 470 * np.sin(np.arange(n) / 500) + np.random.default_rng(1).normal(0, std, n)
    return scale * np.round(torque / 2) * 2


@pytest.mark.parametrize(
    "values",
    [
        noisy(),
        noisy(std=60.0),
        noisy(std=2.0, scale=10.0),
        noisy(std=60.0, scale=1000.0),
        (10 * noisy(std=2.0)).astype("<i2").byteswap() / 10.0,
        np.stack([noisy(10_000), noisy(10_000)[::-1]]).T.ravel(),
    ],
    ids=["noise", "much noise", "ten times", "kNm", "byte order", "two vehicles"],
)
def test_no_fixed_number_is_made_of_noise(values):
    assert samples_of(values) == []


@pytest.mark.parametrize("cut", [7, 1000])
def test_a_fixed_number_stands_out_of_noise_whatever_the_torque_is_scaled_by(cut):
    for std, scale in ((2.0, 1.0), (20.0, 1.0), (20.0, 0.001)):
        values = noisy(std=std, scale=scale)
        values[500::1000] = 0.0
        (hint,) = samples_of(values, cut)
        assert "reads exactly zero in " in hint


def van(tmp_path, dbc=DBC, torque=""):
    """Return the report on 120 s of a van that gets faster and slower by its torque."""
    t_s = np.arange(6000) * 0.02
    v = 12 + 6 * np.sin(t_s / 5)
    torque_Nm = 300 + 300 * np.cos(t_s / 5) + np.random.default_rng(2).normal(0, 2, len(t_s))
    raw = {
        288: (10 * torque_Nm, v / 0.39 * 3.9 * 60 / (2 * np.pi) / 0.25),
        304: (v * 360.0, np.zeros(len(t_s))),
    }
    frames = []
    for number, (first, second) in raw.items():
        length = 4 if number == 288 else 3
        for t, a, b in zip(t_s, np.round(first).astype("<i2"), np.round(second).astype("<u2"), strict=True):
            data = (a.tobytes() + b.tobytes())[:length]
            frames.append((round(1e6 * t) + number, number, data))
    (tmp_path / "van.dbc").write_text(dbc)
    config = read_databases(parse_config(CONFIG % (tmp_path / "van.dbc", torque), str(tmp_path / "van.yaml")))
    doctor = Doctor(config)
    doctor.push(FrameBlock.from_frames(sorted(frames)))
    return doctor.report()


def row(report, role):
    return next(found for found in report.roles if found.role == role)


def test_a_torque_that_is_one_gets_no_hint(tmp_path):
    report = van(tmp_path)
    assert not [hint for hint in report.hints if hint.startswith("signals.")]
    assert not report.stops.startswith("signals.")
    assert row(report, "engine_torque").verdict == row(report, "vehicle_speed").verdict == "ok"


def test_a_swapped_byte_order_is_suspected(tmp_path):
    report = van(tmp_path, DBC.replace("Torque : 0|16@1-", "Torque : 7|16@0-"))
    assert "which is no torque: is its byte order wrong" in report.stops
    (hint,) = [hint for hint in report.hints if "beyond the [-1000|2000] Nm that the DBC declares" in hint]
    assert hint.startswith("signals.engine_torque: ") and "byte order, start bit and factor" in hint


def test_a_torque_with_its_sign_turned_is_named(tmp_path):
    report = van(tmp_path, torque=", scale: -1")
    assert report.stops.startswith("signals.engine_torque is negative in ")
    assert not [hint for hint in report.hints if "negative" in hint]


def test_a_torque_that_is_a_ratio_or_in_another_unit_is_named(tmp_path):
    report = van(tmp_path, torque=", scale: 0.001")
    assert report.stops.startswith(
        "signals.engine_torque is between 0.0005 and 0.6 Nm while the vehicle gets"
    )
    assert report.stops.endswith(
        "is it in kN m (unit: kNm), or a ratio of the full torque (scale: that torque)?"
    )


def test_a_role_most_of_whose_samples_are_refused_is_not_ok(tmp_path):
    report = van(tmp_path, torque=", scale: 1000")
    found = row(report, "engine_torque")
    assert found.verdict == "refused" and "jump beyond physics and are not used" in found.hint
    assert report.stops == f"signals.engine_torque: {found.hint}"
    speed = van(tmp_path, DBC.replace("Speed : 0|16@1+", "Speed : 7|16@0+"))
    assert row(speed, "vehicle_speed").verdict == "refused"
    assert any(hint.startswith("signals.vehicle_speed: ") and "byte order" in hint for hint in speed.hints)
