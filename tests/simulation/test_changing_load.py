"""A load that changes in motion: at once, or by so many kilograms per second; interpreted and compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from canest.core import jit
from canest.core.errors import ConfigError
from canest.core.samples import GRAVITY_MPS2
from canest.simulation import SimulatedDrive, load_scenario, simulate
from canest.simulation.data_sheet import known_config

from .conftest import INERTIA_KG, MASS_KG, steady

STOP_AND_GO = {
    "kind": "given",
    "at_s": [0.0, 5.0, 6.0, 20.0, 21.0],
    "speed_mps": [6.0, 6.0, 0.0, 0.0, 6.0],
    "start_mps": 6.0,
}


def mass_at(drive: SimulatedDrive, t_s: float) -> float:
    return float(np.interp(t_s, drive.history["t_s"], drive.history["mass_kg"]))


def stopping(changes: list[dict[str, Any]], duration_s: float = 30.0, **more: Any) -> SimulatedDrive:
    scenario = {"duration_s": duration_s, "vehicle": "class8", "driver": STOP_AND_GO, "mass_kg": changes}
    return simulate(scenario | more)


def test_a_change_in_motion_happens_at_its_time_with_continuous_speed():
    drive = steady(
        mass_kg=[{"t_s": 0, "mass_kg": 20e3}, {"t_s": 3, "mass_kg": 30e3, "moving": True}], duration_s=6
    )
    t, mass, speed = (drive.history[name] for name in ("t_s", "mass_kg", "speed_mps"))
    assert np.all(mass[t < 2.99] == 20e3)
    assert np.all(mass[t > 3.01] == 30e3)
    assert np.abs(np.diff(speed)).max() < 0.01
    before, after = ((speed[b] - speed[a]) / (t[b] - t[a]) for a, b in ((300, 590), (700, 990)))
    assert after < 0.8 * before
    truth = drive.truth["mass_kg"]
    assert (truth[29], truth[31]) == (20e3, 30e3)


def test_a_change_without_moving_waits_for_the_standstill():
    drive = stopping([{"t_s": 0, "mass_kg": 20e3}, {"t_s": 3, "mass_kg": 30e3}])
    assert mass_at(drive, 5.0) == 20e3
    assert mass_at(drive, 19.0) == 30e3


def test_a_change_in_motion_replaces_one_that_no_standstill_let_happen():
    changes = [
        {"t_s": 0, "mass_kg": 20e3},
        {"t_s": 1, "mass_kg": 30e3},
        {"t_s": 3, "mass_kg": 25e3, "moving": True},
    ]
    drive = stopping(changes)
    assert set(np.unique(drive.history["mass_kg"])) == {20e3, 25e3}


def test_a_change_in_motion_happens_at_a_standstill_too():
    drive = stopping([{"t_s": 0, "mass_kg": 20e3}, {"t_s": 15, "mass_kg": 25e3, "moving": True}])
    assert (mass_at(drive, 14.9), mass_at(drive, 15.1)) == (20e3, 25e3)


def test_a_spreader_loses_its_rate_while_it_moves_and_nothing_while_it_stands():
    drive = stopping([{"t_s": 0, "mass_kg": 20e3, "rate_kgps": -14.0}])
    t, mass, speed = (drive.history[name] for name in ("t_s", "mass_kg", "speed_mps"))
    moving_s = np.count_nonzero(speed >= 0.01) * 0.005
    assert moving_s < 25.0
    assert mass[-1] == pytest.approx(20e3 - 14.0 * moving_s, abs=1.0)
    assert np.ptp(mass[(t > 15) & (t < 20)]) == 0.0
    assert drive.truth["mass_kg"][40] == pytest.approx(20e3 - 14.0 * 4.0, abs=1.0)


def test_a_rate_ends_with_the_next_change():
    changes = [
        {"t_s": 0, "mass_kg": 20e3, "rate_kgps": -10.0},
        {"t_s": 3, "mass_kg": 19e3, "moving": True},
    ]
    drive = steady(mass_kg=changes)
    assert mass_at(drive, 2.9) == pytest.approx(20e3 - 29.0, abs=0.2)
    assert np.ptp(drive.history["mass_kg"][drive.history["t_s"] > 3.01]) == 0.0


def test_what_is_lost_in_motion_takes_no_momentum_from_the_rest():
    losing = steady(throttle=0.0, mass_kg=[{"t_s": 0, "mass_kg": MASS_KG, "rate_kgps": -1000.0}])
    speed, mass, torque = (losing.history[name] for name in ("speed_mps", "mass_kg", "wheel_torque_Nm"))
    at, later = 400, 1000
    seconds = (later - at) * 0.005
    accel = (speed[later] - speed[at]) / seconds
    m, v = mass[at:later].mean(), speed[at:later].mean()
    force = torque[at:later].mean() / 0.5 - 0.5 * 1.184 * 6.4 * v * v - 0.006 * m * GRAVITY_MPS2
    assert accel == pytest.approx(force / (m + 130 / 0.25), rel=0.05)
    assert INERTIA_KG > 130 / 0.25


def test_compiled_gives_the_same_bits():
    if not jit.available():
        pytest.skip("numba is not installed")
    changes = [
        {"t_s": 0, "mass_kg": 20e3, "rate_kgps": -10.0},
        {"t_s": 2, "mass_kg": 30e3},
        {"t_s": 4, "mass_kg": 25e3, "moving": True, "rate_kgps": 8.0},
        {"t_s": 10, "mass_kg": 28e3},
    ]
    interpreted = stopping(changes)
    jit.enable()
    try:
        compiled = stopping(changes)
    finally:
        jit.enable(False)
    for name, column in interpreted.history.items():
        np.testing.assert_array_equal(column, compiled.history[name], err_msg=name)


def test_the_config_covers_what_a_spreader_may_become():
    spec = {"duration_s": 600, "vehicle": "class8", "driver": {"kind": "mixed"}}
    changes = [{"t_s": 0, "mass_kg": 12e3, "rate_kgps": -14.0}]
    declared = known_config(load_scenario(spec | {"mass_kg": changes}))["vehicle"]
    assert declared["mass_min_kg"] < 12e3 - 14.0 * 600


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            [{"t_s": 0, "mass_kg": 9000, "rate_kgps": -400}],
            "mass_kg: found a rate_kgps that leaves -3000 kg, expected a mass above 0",
        ),
        ([{"t_s": 0, "mass_kg": 9000, "rate_kgps": "fast"}], "rate_kgps, found 'fast', expected a number"),
        ([{"t_s": 0, "mass_kg": 9000, "rate_kgps": float("inf")}], "finite"),
        ([{"t_s": 0, "mass_kg": 9000, "moving": 3}], "moving, found 3"),
        ([{"t_s": 0, "mass_kg": 9000}, {"t_s": 3, "mass_kg": -1, "moving": True}], "found -1"),
        ([{"t_s": 0, "mass_kg": 9000, "rate_kgs": -10}], "rate_kgs: unknown key"),
    ],
)
def test_a_mass_that_cannot_be_is_refused(changes: list[dict[str, Any]], message: str):
    with pytest.raises(ConfigError) as caught:
        stopping(changes)
    assert message in str(caught.value)


def test_a_rate_that_ends_in_time_is_not_refused():
    stopped = {"t_s": 10, "mass_kg": 5000, "moving": True}
    stopping([{"t_s": 0, "mass_kg": 9000, "rate_kgps": -400}, stopped])


def test_an_undeclared_payload_beside_a_load_that_changes_in_motion_is_refused():
    payload = {"effect": "payload_change", "mass_delta_kg": 500, "t_s": 5}
    with pytest.raises(ConfigError, match="payload_change needs a mass that changes at standstills"):
        stopping([{"t_s": 0, "mass_kg": 9000, "rate_kgps": -4}], undeclared=[payload])
