"""A bound of the mass is called wrong only where the driving shows it, significantly."""

from dataclasses import replace
from pathlib import Path

import pytest

import canest
from canest.core.samples import VehicleFacts
from canest.estimators.bounds import beyond_bound

FACTS = VehicleFacts(7_000.0, 40_000.0, torque_accuracy=0.01, wheel_radius_accuracy=0.0)
ROTATING = Path(__file__).parents[1] / "data" / "obd-car" / "rotating-28-pids.csv.xz"
CAR = """
vehicle: {name: car, mass_min_kg: 1300, mass_max_kg: MOST, wheel_radius_m: 0.31, wheel_inertia_kgm2: 4,
  gear_ratios: {1: 3.78, 2: 2.06, 3: 1.35, 4: 0.97, 5: 0.77, 6: 0.63}, final_drive: 3.6,
  driveline_efficiency: 0.95,
  engine_inertia_kgm2: 0.2, reference_torque_Nm: 320, friction_torque_pct: 8, drag_area_m2: 0.7,
  rolling_resistance: 0.010}
dbc: []
estimator: {name: ESTIMATOR}
signals:
  engine_torque_pct: {column: torque, unit: "%", stale_s: 2}
  engine_speed: {column: rpm, unit: rpm, stale_s: 2}
  vehicle_speed: {column: kmh, unit: km/h, stale_s: 2}
  accelerator: {column: throttle, unit: "%", stale_s: 2}
"""


def contradiction(mass_kg, share, **facts):
    """Return what is reported of a posterior with this mean and relative standard deviation."""
    return beyond_bound(1.0 / mass_kg, (share / mass_kg) ** 2, replace(FACTS, **facts))


def test_beyond_by_more_than_its_std_allows():
    assert "heavier than vehicle.mass_max_kg = 40,000 kg" in contradiction(42_000, 0.01)
    assert "lighter than vehicle.mass_min_kg = 7,000 kg" in contradiction(6_600, 0.01)


def test_within_the_bounds_or_beyond_by_less_than_three_standard_deviations():
    assert contradiction(21_000, 0.01) == contradiction(41_000, 0.01) == contradiction(6_800, 0.01) == ""


def test_a_torque_that_is_known_less_well_allows_more():
    assert contradiction(42_500, 0.01, torque_accuracy=0.03) == ""
    assert contradiction(42_500, 0.01, wheel_radius_accuracy=0.015) == ""
    assert contradiction(50_000, 0.01, torque_accuracy=0.03)


def test_a_posterior_that_is_wider_than_a_valid_one_contradicts_nothing_however_far_off():
    assert contradiction(200_000, 0.30) == beyond_bound(-1e-6, 4e-12, FACTS) == ""


def test_a_speed_that_hardly_follows_the_torque_is_named():
    """A torque reported ten times too large: a mass without end, at its bound and never valid."""
    assert "hardly follows the torque" in beyond_bound(-4e-7, 1e-13, FACTS)
    assert "hardly follows the torque" in contradiction(400_000, 0.2)
    assert "heavier than" in contradiction(100_000, 0.02)


@pytest.mark.parametrize("estimator", ["canest-0.1", "canest"])
@pytest.mark.parametrize("most_kg", [1_700, 2_500])
def test_a_measured_car_of_which_nothing_was_learned(tmp_path, estimator, most_kg):
    """Every signal comes once in seven seconds: 0.1.0 called both bounds wrong, with a mass never valid."""
    config = tmp_path / "car.yaml"
    config.write_text(CAR.replace("MOST", str(most_kg)).replace("ESTIMATOR", estimator))
    result = canest.replay(ROTATING, config)
    assert result.summary["last_valid"] is None
    assert not any("bound" in note for note in result.summary["notes"])
