"""A torque that acts later than it is reported: by a delay, or by a lag of first order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.default.constants import CONSTANTS, vehicle_of
from canest.estimators.default.model import Window
from canest.estimators.default.noise import first_levels, follow
from canest.estimators.default.sensors import ends_at, slow_traction
from canest.estimators.registry import create
from canest.estimators.windowing import WINDOW_S

from . import momentum
from .momentum import flat, hills, pulses, trip
from .test_canest_loads_and_roads import STATED

KG = 21_000.0


def steps(t, v):
    """Throttle that is set and taken away, as a driver of a truck does."""
    return 0.7 if t % 9.0 < 5.0 and v < 24.0 else 0.02


@pytest.mark.parametrize("lag_s", [0.1, 0.2])
@pytest.mark.parametrize("sensed", [False, True])
@pytest.mark.parametrize("road", [flat, hills])
def test_a_force_that_lags_its_report_leaves_the_mass_right(road, sensed, lag_s):
    drive = trip(120, mass_kg=KG, road=road, throttle=steps, accelerometer=sensed, lag_s=lag_s)
    estimates = create("canest", replace(STATED, has_accelerometer=sensed)).update(drive.block)
    late = slice(60 * 50, None)
    valid = estimates.status[late] == Status.VALID
    assert valid.mean() > 0.9
    assert np.abs(drive.error(estimates)[late][valid]).max() < 0.025


@pytest.mark.parametrize("rotating_kg", [700.0, 21_000.0])
@pytest.mark.parametrize("sensed", [False, True])
def test_a_delay_is_found_in_every_gear(monkeypatch, rotating_kg, sensed):
    """In the lowest gear of a truck as much rotates as moves, and a delay shows by half."""
    monkeypatch.setattr(momentum, "ROTATING_KG", rotating_kg)
    found_s = []
    for delay_s in (0.08, 0.2):
        drive = trip(90, mass_kg=KG, road=flat, throttle=pulses, accelerometer=sensed, delay_s=delay_s)
        estimator = create("canest", replace(STATED, has_accelerometer=sensed))
        estimator.update(drive.block)
        found_s.append(estimator._carried.progress.delay_s)
    assert found_s[1] - found_s[0] == pytest.approx(0.12, abs=0.02)


def cruise_control(t, v):
    """Set torque by how much slower than 22 m/s the vehicle is: after a climb has slowed it."""
    return float(np.clip(0.25 + 0.25 * (22.0 - v), -0.03, 0.85))


@pytest.mark.parametrize("sensed", [False, True])
def test_a_cruise_control_that_answers_late_is_no_delay_of_the_torque(sensed):
    """Else the delay is -0.08 s after ten minutes, -0.05 with accelerometer, and goes on to its bound."""
    drive = trip(600, mass_kg=KG, road=hills, throttle=cruise_control, accelerometer=sensed)
    estimator = create("canest", replace(STATED, has_accelerometer=sensed))
    estimator.update(drive.block)
    assert estimator._carried.progress.delay_s == pytest.approx(0.0, abs=0.02)
    assert estimator.contradiction() == ""


def window(begin_N, end_N):
    return Window(**dict.fromkeys(Window._fields, 0.0))._replace(begin_N=begin_N, traction_N=end_N)


@pytest.mark.parametrize("dt", [0.2, 1.0])
def test_the_slow_traction_follows_a_ramp_as_its_differential_equation_does(dt):
    begin_N, end_N, slow_N = 2000.0, -7000.0, 5000.0
    expected, n = slow_N, 200_000
    for k in range(n):
        at = begin_N + (end_N - begin_N) * (k + 0.5) / n
        expected += (at - expected) * dt / n / WINDOW_S
    found = slow_traction.interpreted(slow_N, window(begin_N, end_N), dt)
    assert found == pytest.approx(expected, rel=1e-4)
    rate_Nps = ends_at.interpreted(20.0, (end_N, found), 0.0, False).traction_Nps
    assert rate_Nps == pytest.approx((end_N - expected) / WINDOW_S, rel=1e-4)


def test_a_traction_that_stays_is_reached():
    slow_N = 0.0
    for _ in range(20):
        slow_N = slow_traction.interpreted(slow_N, window(9000.0, 9000.0), WINDOW_S)
    assert slow_N == pytest.approx(9000.0, rel=1e-6)


def bumps(s):
    return 0.004 * sum(np.sin(s / of_m + 2.1 * k) for k, of_m in enumerate((15, 30, 60, 120, 240)))


def controlled(t, v):
    """A stiff cruise control between bursts of pulses."""
    return pulses(t, v) if t % 60.0 <= 12.0 else float(np.clip(0.25 + 0.9 * (20.0 - v), 0.0, 0.85))


def test_torque_that_follows_the_road_is_no_delay():
    """What a controller does after the road has slowed the vehicle was taken for a delay of 0.8 s."""
    drive = trip(300, mass_kg=KG, road=bumps, throttle=controlled)
    estimator = create("canest", STATED)
    estimator.update(drive.block)
    assert abs(estimator._carried.progress.delay_s) < CONSTANTS.longest_delay_s


def kicks(t, v):
    """All or nothing, every three seconds."""
    return 0.9 if t % 6.0 < 3.0 and v < 26.0 else 0.0


@pytest.mark.parametrize(
    ("road", "late_s", "seed"),
    [(flat, 0.4, 1), (hills, 0.4, 1), (hills, 0.5, 1), (flat, 0.4, 2), (hills, 0.5, 2)],
)
def test_what_the_model_does_not_explain_takes_valid_away(road, late_s, seed):
    """The report of the torque is late for 90 s: masses were valid and 8 % off, then and after it."""
    usual = trip(420, mass_kg=KG, road=road, throttle=kicks, accelerometer=True, seed=seed)
    late = trip(420, mass_kg=KG, road=road, throttle=kicks, accelerometer=True, delay_s=late_s, seed=seed)
    t_s = np.arange(len(usual.block)) * 0.02
    columns = {}
    for name in ("traction_N", "force_N", "raw_force_N", "raw_torque_Nm"):
        both = [getattr(drive.block, name) for drive in (late, usual)]
        columns[name] = np.where((t_s >= 120.0) & (t_s < 210.0), *both)
    block = replace(usual.block, **columns)
    estimator = create("canest", replace(STATED, has_accelerometer=True))
    first = estimator.update(block[: 200 * 50])
    assert "do not go together" in estimator.contradiction()
    rest = estimator.update(block[200 * 50 :])
    assert estimator.contradiction() == ""
    valid = np.concatenate((first.status, rest.status)) == Status.VALID
    error = np.abs(np.concatenate((first.mass_kg, rest.mass_kg)) / KG - 1.0)
    assert valid[(t_s >= 60.0) & (t_s < 120.0)].all()
    assert error[valid & (t_s >= 60.0)].max() < 0.08
    assert valid[t_s >= 400.0].all()


@pytest.mark.parametrize(("gross", "expected"), [(0, False), (5, False), (12, True)])
def test_a_few_gross_windows_in_two_minutes_refute_no_model(gross, expected):
    vehicle = vehicle_of(STATED, 0.1, CONSTANTS)
    levels = first_levels.interpreted(vehicle)
    found = []
    for k in range(1200):
        is_gross = k >= 600 and gross > 0 and k % (600 // gross) == 0
        nis = 1e4 if is_gross else 0.8
        levels = follow.interpreted(levels, window(0.0, 0.0), (nis, 0.0), 0.0, 0.0, False, CONSTANTS, vehicle)
        found.append(levels.refuted > 0.0)
    assert any(found) == expected


def test_a_torque_held_while_standing_has_no_rate_afterwards():
    """Standing windows wait; where the vehicle moves off, the lag of the traction begins at the traction."""
    drive = trip(60.0, road=flat, throttle=lambda t, v: 0.3, stops=[(20.0, 50.0)])
    traction_N = drive.block.traction_N.copy()
    traction_N[1_500:2_700] = 9_000.0
    block = replace(drive.block, traction_N=traction_N)
    estimator = create("canest", momentum.FACTS)
    moves = 10 * int(np.flatnonzero(~block.stopped[1_500::10])[0]) + 1_510
    for end in range(10, moves + 1, 10):
        estimator.update(block[end - 10 : end])
    assert not block.stopped[moves - 1]
    assert estimator._carried.progress.slow_N == pytest.approx(9_000.0, rel=0.01)
