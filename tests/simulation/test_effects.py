"""Every undeclared effect: its sign and size against a sum done by hand, and that neutral means none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from canest.simulation import simulate
from canest.simulation.effects import Effect
from canest.vehicle.effects import EFFECTS

from .conftest import (
    EFFICIENCY,
    INERTIA_KG,
    MASS_KG,
    QUIET,
    RADIUS_M,
    RATIO,
    START_MPS,
    steady,
)

PER_NM = RATIO * EFFICIENCY / RADIUS_M  # newtons at the road per newton metre at the crank
HALF_RHO = 0.5 * 1.184


def change_of_force(effect: dict[str, Any], **changes: Any) -> float:
    """Return the force that an effect adds along the motion, from the speed it has changed after 3 s."""
    with_effect = steady(duration_s=3.0, effects=[effect], **changes).history["speed_mps"]
    without = steady(duration_s=3.0, **changes).history["speed_mps"]
    window = slice(200, 600)  # from 1 s to 3 s
    lost = (with_effect - without)[window]
    return float((lost[-1] - lost[0]) / (len(lost) - 1) / 0.005 * (MASS_KG + INERTIA_KG))


def net_torque_Nm(throttle: float = 0.6) -> float:
    history = steady(throttle=throttle, duration_s=3.0).history
    return float(history["crank_Nm"][200:600].mean())


@pytest.mark.parametrize(
    ("effect", "force_N"),
    [
        ({"effect": "headwind", "wind_mps": 6.0}, -HALF_RHO * 6.4 * (26.0**2 - 20.0**2)),
        ({"effect": "headwind", "wind_mps": -6.0}, -HALF_RHO * 6.4 * (14.0**2 - 20.0**2)),
        ({"effect": "drag_area", "cda_delta_m2": 2.0}, -HALF_RHO * 2.0 * 20.0**2),
        ({"effect": "rolling_resistance", "crr_delta": 0.003}, -0.003 * MASS_KG * 9.80665),
        ({"effect": "rolling_resistance_speed", "crr_per_mps": 2e-4}, -2e-4 * 20.0 * MASS_KG * 9.80665),
        ({"effect": "rolling_warmup", "crr_cold": 0.003, "tau_s": 1e6}, -0.003 * MASS_KG * 9.80665),
        ({"effect": "torque_offset", "torque_Nm": 100.0}, -100 * PER_NM),
        ({"effect": "brake_drag", "force_N": 800.0}, -800.0),
        ({"effect": "switched_load", "power_kW": 30.0}, -30e3 / (20.0 / RADIUS_M * RATIO) * PER_NM),
    ],
)
def test_a_resistance_takes_this_force_from_the_motion(effect: dict[str, Any], force_N: float):
    assert change_of_force(effect) == pytest.approx(force_N, rel=0.06)


def test_a_gain_below_one_takes_traction_away():
    found = change_of_force({"effect": "torque_gain", "gain": 0.9})
    assert found == pytest.approx(-0.1 * net_torque_Nm() * PER_NM, rel=0.06)


def test_a_loss_takes_its_share_of_the_traction_in_its_gear_only():
    expected = -0.08 * net_torque_Nm() * PER_NM
    in_all = change_of_force({"effect": "driveline_loss", "loss": 0.08})
    assert in_all == pytest.approx(expected, rel=0.06)
    assert change_of_force({"effect": "driveline_loss", "loss": 0.08, "gear": 9}) == in_all
    assert change_of_force({"effect": "driveline_loss", "loss": 0.08, "gear": 8}) == 0.0


def test_inertia_at_the_crank_slows_the_same_torque_down():
    plain = steady(duration_s=3.0).history["speed_mps"]
    heavy = steady(duration_s=3.0, effects=[{"effect": "rotating_inertia", "inertia_kgm2": 6.4}]).history[
        "speed_mps"
    ]
    gained = [(v[-1] - v[200]) for v in (plain, heavy)]
    inertia = MASS_KG + INERTIA_KG
    added = 6.4 * EFFICIENCY * (RATIO / RADIUS_M) ** 2
    assert gained[1] / gained[0] == pytest.approx(inertia / (inertia + added), abs=0.003)


def test_bends_cost_force_by_the_square_of_lateral_acceleration():
    bend = {"kind": "points", "at_m": [0, 1000], "grade": [0, 0], "curvature_1pm": [0.005, 0.005]}
    found = change_of_force({"effect": "cornering_drag", "coefficient_s2pm": 0.05}, road=bend)
    lateral = START_MPS**2 * 0.005
    assert found == pytest.approx(-MASS_KG * 0.05 * lateral**2, rel=0.1)
    assert change_of_force({"effect": "cornering_drag", "coefficient_s2pm": 0.05}) == 0.0


def test_the_unreported_retarder_brakes_while_the_pedal_is_up_and_is_not_on_the_bus():
    effect = {"effect": "retarder_unreported", "torque_Nm": 300.0}
    found = change_of_force(effect, throttle=0.0)
    assert found == pytest.approx(-300 * RATIO / EFFICIENCY / RADIUS_M, rel=0.08)
    assert change_of_force(effect, throttle=0.6) == 0.0
    drive = steady(throttle=0.0, effects=[effect])
    erc1 = drive.frames.data[(drive.frames.can_id & 0x1FFFFFFF) == 0x18F0000F]
    assert np.all((erc1 >> np.uint64(8)) & np.uint64(0xFF) == 125)  # 0 %


def test_smaller_tyres_turn_faster_and_push_harder():
    drive = steady(effects=[{"effect": "wheel_radius", "factor": 0.97}])
    history = drive.history
    declared = history["wheel_radps"] * RADIUS_M
    assert declared / history["speed_mps"] == pytest.approx(1 / 0.97, rel=1e-6)
    etc1 = drive.frames[(drive.frames.can_id & 0x1FFFFFFF) == 0x0CF00203]
    shaft_rpm = ((etc1.data[-1] >> np.uint64(8)) & np.uint64(0xFFFF)) * 0.125
    reported = shaft_rpm / 60 * 2 * np.pi / 3.73 * RADIUS_M
    assert reported == pytest.approx(history["speed_mps"][-1] / 0.97, rel=1e-3)
    crank, wheels = history["crank_Nm"][-200:].mean(), history["wheel_torque_Nm"][-200:].mean()
    assert wheels / (RADIUS_M * 0.97) > 1.02 * crank * PER_NM * 0.97
    assert wheels == pytest.approx(crank * RATIO * EFFICIENCY, rel=0.02)


@pytest.mark.parametrize(("axles", "expected"), [("driven", 1.0), ("all", 1 / 0.97)])
def test_an_undriven_axle_has_tyres_of_its_own(axles: str, expected: float):
    drive = steady(effects=[{"effect": "wheel_radius", "factor": 0.97, "axles": axles}])
    ebc2 = drive.frames[(drive.frames.can_id & 0x1FFFFFFF) == 0x18FEBF0B]
    front_mps = (ebc2.data & np.uint64(0xFFFF)) / 256 / 3.6
    truth = np.interp((ebc2.t_us - 1.7e15) / 1e6, drive.history["t_s"], drive.history["speed_mps"])
    assert front_mps[5:] / truth[5:] == pytest.approx(expected, rel=2e-3)


def test_slip_lets_the_driven_wheels_run_ahead_under_traction():
    history = steady(effects=[{"effect": "wheel_slip", "slip_per_mps2": 0.02}]).history
    traction = history["wheel_torque_Nm"] / RADIUS_M / MASS_KG
    slip = history["wheel_radps"] * RADIUS_M / history["speed_mps"] - 1
    assert slip[-1] > 0
    assert slip[-200:] == pytest.approx(0.02 * traction[-200:], abs=2e-5)


def test_torque_is_reported_later_than_it_acts():
    def first_rise_s(effects: list[dict[str, Any]]) -> tuple[float, float]:
        drive = steady(throttle=1.0, duration_s=3.0, effects=effects)
        eec1 = drive.frames[(drive.frames.can_id & 0x1FFFFFFF) == 0x0CF00400]
        percent = ((eec1.data >> np.uint64(16)) & np.uint64(0xFF)).astype(float) - 125
        acts = drive.history["t_s"][np.argmax(drive.history["indicated_Nm"] > 0.30 * 2100)]
        return (eec1.t_us[np.argmax(percent >= 30)] - 1.7e15) / 1e6, acts

    plain, acted = first_rise_s([])
    late, acted_late = first_rise_s([{"effect": "torque_delay", "delay_s": 0.2}])
    assert acted == acted_late
    assert late - plain == pytest.approx(0.2, abs=0.025)


def test_a_cubic_load_grows_with_engine_speed_and_shows_on_the_bus():
    load = {
        "effect": "switched_load",
        "power_kW": 32.0,
        "law": "cubic",
        "at_rpm": 1500.0,
        "on_s": 2.0,
        "period_s": 4.0,
    }
    drive = steady(duration_s=4.0, effects=[load])
    h = drive.history
    w = h["engine_radps"]
    belief = h["indicated_Nm"] - 2100 * (0.065 + 0.018 * w * 60 / 2 / np.pi / 1000)
    taken_kW = (belief - h["crank_Nm"]) * w / 1000
    rpm = w * 60 / 2 / np.pi
    on = h["load_on"] > 0
    assert taken_kW[on][10:-10] == pytest.approx(32.0 * (rpm[on][10:-10] / 1500) ** 3, rel=0.02)
    assert np.abs(taken_kW[~on]).max() < 0.2
    fan = drive.frames.data[(drive.frames.can_id & 0x1FFFFFFF) == 0x18FEBD00] & np.uint64(0xFF)
    assert fan[0] * 0.4 == pytest.approx(rpm[0] / 2000 * 100, abs=2)
    assert fan[2] == 0


def test_payload_changes_at_the_first_standstill():
    drive = simulate(
        {
            "duration_s": 60,
            "vehicle": "class8",
            "mass_kg": 15000,
            "driver": {
                "kind": "given",
                "at_s": [0, 20, 32, 60],
                "speed_mps": [10, 10, 0, 0],
                "start_mps": 10,
            },
            "undeclared": [{"effect": "payload_change", "mass_delta_kg": 5000, "t_s": 10.0}],
        }
    )
    changed = int(np.argmax(drive.truth["mass_kg"] == 20000))
    assert drive.truth["mass_kg"][0] == 15000
    assert drive.truth["speed_mps"][changed] < 0.05
    assert 20 < changed / 10 < 45
    assert drive.truth["mass_kg"][-1] == 20000


def test_drafting_comes_and_goes_and_only_ever_helps():
    plain = steady(duration_s=60.0, throttle=0.5)
    behind = steady(
        duration_s=60.0, throttle=0.5, effects=[{"effect": "drafting", "reduction": 0.4, "period_s": 10}]
    )
    gained = np.diff(behind.history["speed_mps"] - plain.history["speed_mps"])
    assert behind.history["speed_mps"][-1] > plain.history["speed_mps"][-1]
    assert 0.1 < np.mean(gained > 1e-5) < 0.9


NEUTRAL: list[dict[str, Any]] = [
    {"effect": "headwind", "wind_mps": 0.0},
    {"effect": "drag_area", "cda_delta_m2": 0.0},
    {"effect": "rolling_resistance", "crr_delta": 0.0},
    {"effect": "rolling_resistance_speed", "crr_per_mps": 0.0},
    {"effect": "rolling_warmup", "crr_cold": 0.0, "tau_s": 300.0},
    {"effect": "torque_gain", "gain": 1.0},
    {"effect": "torque_offset", "torque_Nm": 0.0},
    {"effect": "torque_delay", "delay_s": 0.0},
    {"effect": "driveline_loss", "loss": 0.0, "gear": None},
    {"effect": "wheel_radius", "factor": 1.0},
    {"effect": "rotating_inertia", "inertia_kgm2": 0.0},
    {"effect": "brake_drag", "force_N": 0.0},
    {"effect": "retarder_unreported", "torque_Nm": 0.0},
    {"effect": "cornering_drag", "coefficient_s2pm": 0.0},
    {"effect": "wheel_slip", "slip_per_mps2": 0.0},
    {"effect": "payload_change", "mass_delta_kg": 0.0, "t_s": 1.0},
]


def test_neutral_values_mean_no_effect_at_all():
    plain = steady(throttle=0.3, sensors=QUIET | {"shaft_noise_rpm": 0.4})
    neutral = steady(throttle=0.3, sensors=QUIET | {"shaft_noise_rpm": 0.4}, effects=NEUTRAL)
    assert np.array_equal(plain.frames.data, neutral.frames.data)
    assert np.array_equal(plain.frames.t_us, neutral.frames.t_us)


def test_small_errors_are_small_and_leave_the_road_alone():
    base = {
        "duration_s": 20,
        "vehicle": "class8",
        "mass_kg": 20000,
        "road": {"kind": "highway", "level_start_m": 0},
        "driver": {"kind": "pulses", "start_mps": 18},
    }
    for seed in range(5):
        plain, real = simulate(base, seed), simulate(base | {"small_errors": True}, seed)
        found = {effect["effect"]: effect for effect in real.undeclared}
        assert abs(found["torque_gain"]["gain"] - 1) <= 0.02
        assert abs(found["headwind"]["wind_mps"]) <= 3
        assert abs(found["rolling_resistance"]["crr_delta"]) <= 0.15 * 0.006
        assert plain.undeclared == []
        assert plain.config == real.config
        at = real.history["distance_m"]
        known = np.interp(at, plain.history["distance_m"], plain.history["grade"])
        inside = at < plain.history["distance_m"][-1]
        assert real.history["grade"][inside] == pytest.approx(known[inside], abs=2e-4)


def test_a_switched_load_may_be_written_as_in_a_config():
    """What `canest diagnose` writes can be planted again."""
    simulated = TypeAdapter(Effect)
    written = EFFECTS["switched_load"](
        on_signal="fan_speed", power_kW=30.0, exponent=3.0, threshold=50.0
    ).to_config()
    planted = simulated.validate_python(written)
    assert (planted.signal, planted.power_kW, planted.law, planted.at_rpm) == (
        "fan_speed",
        30.0,
        "cubic",
        1500.0,
    )
    with pytest.raises(ValueError, match="found exponent 2"):
        simulated.validate_python(written | {"exponent": 2.0})
