"""Forces and energies of a simulated drive, against sums done by hand."""

from __future__ import annotations

import numpy as np
import pytest

from canest.simulation import SimulatedDrive, simulate

from .conftest import EFFICIENCY, INERTIA_KG, MASS_KG, RADIUS_M, RATIO, steady

G = 9.80665


def test_coasting_in_gear_decelerates_by_drag_rolling_and_engine_friction():
    history = steady(throttle=0.0).history
    at = np.searchsorted(history["t_s"], 4.0)
    v, w = history["speed_mps"][at], history["engine_radps"][at]
    aero = 0.5 * 1.184 * 6.4 * v * v
    rolling = 0.006 * MASS_KG * G
    friction_Nm = 2100 * (0.065 + 0.018 * w * 60 / 2 / np.pi / 1000)
    engine = friction_Nm * RATIO / EFFICIENCY / RADIUS_M  # overrun: the losses help to brake
    # the engine's inertia is behind the same losses
    inertia = MASS_KG + 130 / RADIUS_M**2 + 3.2 * (RATIO / RADIUS_M) ** 2 / EFFICIENCY
    assert history["accel_mps2"][at] == pytest.approx(-(aero + rolling + engine) / inertia, rel=0.01)


def test_a_steady_throttle_on_a_slope_accelerates_by_the_force_that_is_left():
    history = steady(throttle=0.8, road={"kind": "flat", "grade": 0.02}).history
    at = np.searchsorted(history["t_s"], 5.0)
    v, w = history["speed_mps"][at], history["engine_radps"][at]
    friction_Nm = 2100 * (0.065 + 0.018 * w * 60 / 2 / np.pi / 1000)
    traction = (history["indicated_Nm"][at] - friction_Nm) * RATIO * EFFICIENCY / RADIUS_M
    beta = np.arctan(0.02)
    resistance = 0.5 * 1.184 * 6.4 * v * v + MASS_KG * G * (np.sin(beta) + 0.006 * np.cos(beta))
    inertia = MASS_KG + 130 / RADIUS_M**2 + 3.2 * EFFICIENCY * (RATIO / RADIUS_M) ** 2
    assert history["accel_mps2"][at] == pytest.approx((traction - resistance) / inertia, rel=0.02)
    assert inertia == pytest.approx(MASS_KG + INERTIA_KG, rel=0.01)


def test_the_work_of_the_wheels_goes_into_motion_height_air_and_tyres(pulses: SimulatedDrive):
    h = pulses.history
    v, dt = h["speed_mps"], 0.005
    work = np.sum(h["wheel_torque_Nm"] / RADIUS_M * v) * dt
    kinetic = 0.5 * (21250 + 130 / RADIUS_M**2) * (v[-1] ** 2 - v[0] ** 2)
    potential = 21250 * G * (h["elevation_m"][-1] - 100.0)
    air = np.sum(0.5 * 1.184 * 6.4 * v**3) * dt
    tyres = np.sum(0.006 * 21250 * G * v / np.sqrt(1 + h["grade"] ** 2)) * dt
    assert work == pytest.approx(kinetic + potential + air + tyres, rel=0.003)


def test_shifts_leave_holes_in_the_traction(pulses: SimulatedDrive):
    h = pulses.history
    neutral = h["phase"] == 2
    starts = np.flatnonzero(np.diff(neutral.astype(int)) == 1)
    assert len(starts) >= 10
    assert np.all(h["wheel_torque_Nm"][neutral] == 0)
    assert 0.4 < neutral.sum() * 0.005 / len(starts) < 1.5


def test_engine_and_wheels_turn_together_only_while_engaged(pulses: SimulatedDrive):
    h = pulses.history
    ratios = np.array([12.69, 9.29, 6.75, 4.90, 3.62, 2.59, 1.90, 1.38, 1.00, 0.74]) * 3.73
    geared = h["wheel_radps"] * ratios[h["gear"].astype(int)]
    off = np.abs(h["engine_radps"] - geared)
    assert np.percentile(off[h["phase"] == 0], 99) < 2.0
    assert off[h["phase"] == 2].max() > 20.0


def test_torque_builds_up_late_when_the_turbo_has_run_down():
    history = steady(throttle=1.0, duration_s=4.0).history
    reached = [history["t_s"][np.argmax(history["indicated_Nm"] > share * 2000)] for share in (0.4, 0.95)]
    assert reached[0] < 0.5
    assert 0.8 < reached[1] - reached[0] < 3.0


def test_truth_follows_from_itself(pulses: SimulatedDrive):
    truth = pulses.truth
    assert truth["t_s"][0] == 1_700_000_000
    assert np.diff(truth["t_s"]) == pytest.approx(0.1, abs=1e-6)
    midway = (truth["speed_mps"][1:] + truth["speed_mps"][:-1]) / 2
    assert np.diff(truth["distance_m"]) == pytest.approx(midway * 0.1, abs=0.01)
    climbed = np.sum(np.diff(truth["distance_m"]) * truth["grade"][1:] / np.sqrt(1 + truth["grade"][1:] ** 2))
    assert truth["elevation_m"][-1] - 100 == pytest.approx(climbed, abs=0.5)


@pytest.mark.parametrize("vehicle", ["class8", "light-truck", "car", "electric-car"])
def test_every_vehicle_starts_drives_and_stops(vehicle: str):
    drive = simulate(
        {
            "duration_s": 60,
            "vehicle": vehicle,
            "mass_kg": {"class8": 18000, "light-truck": 6000, "car": 1800, "electric-car": 1500}[vehicle],
            "driver": {"kind": "given", "at_s": [0, 2, 3, 30, 45, 60], "speed_mps": [0, 0, 12, 12, 0, 0]},
        }
    )
    speed = drive.truth["speed_mps"]
    assert speed[20] < 0.1
    assert speed[300] == pytest.approx(12.0, abs=1.0)
    assert speed[-1] == 0.0
    assert np.all(np.isfinite(speed)) and speed.min() >= 0
    assert np.abs(drive.truth["accel_mps2"]).max() < 5.0
