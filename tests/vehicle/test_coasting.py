"""A vehicle coasts where its driveline is open and nothing but air, tyres and slope acts on it."""

from __future__ import annotations

import numpy as np
import pytest
from test_gating import CREEPING, DRIVING, SHAFT_RPM, Drive
from vehicle_helpers import RADIUS_M, WHEEL_INERTIA

OPEN = {"driveline_engaged": 0.0, "engine_speed": 0.6 * SHAFT_RPM}
PARTED = OPEN | {"shift_in_process": 1.0}
NEUTRAL = OPEN | {"engine_torque_pct": 8.0}  # 5 % are friction
NAN = float("nan")


def coasts(block):
    return np.isfinite(block.coasting_N)


def test_between_two_gears_it_coasts():
    drive = Drive()
    assert not coasts(drive.go(10)).any()
    parted = drive.go(30, **PARTED)
    assert coasts(parted).all()
    assert parted.coasting_N == pytest.approx(-parted.aero_N, rel=0.01)
    assert parted.rotating_mass_kg == pytest.approx(WHEEL_INERTIA / RADIUS_M**2)
    engaged = drive.go(10)
    assert not coasts(engaged).any()
    assert (engaged.rotating_mass_kg > WHEEL_INERTIA / RADIUS_M**2).all()


def test_in_neutral_it_coasts_without_a_shift():
    drive = Drive()
    assert coasts(drive.go(500, **NEUTRAL)).all()


@pytest.mark.parametrize(
    "doing",
    [
        {"shift_in_process": 1.0},  # torque comes and goes, the driveline is closed
        {"clutch_switch": 1.0},  # the foot is on the pedal, the clutch may be anywhere
        {"lockup_engaged": 0.0},  # a converter drives
        {"clutch_slip": 50.0},
        {"driveline_engaged": NAN},
        {"driveline_engaged": 0.0},  # says one, and the engine turns with the wheels
        OPEN,  # the clutch slips, and the engine pulls
        PARTED | {"engine_speed": 1.02 * SHAFT_RPM},
        PARTED | {"brake_switch": 1.0},
        PARTED | {"brake_switch": NAN, "brake_pedal": NAN},  # the brakes may be on
        PARTED | {"retarder_torque_pct": -40.0},
        PARTED | {"yaw_rate": 0.3},
        PARTED | {"output_shaft_speed": NAN, "vehicle_speed": NAN, "undriven_speed": NAN},
    ],
)
def test_elsewhere_it_does_not(doing):
    assert not coasts(Drive().go(30, **doing)).any()


def test_no_shift_takes_for_ever():
    after = coasts(Drive().go(400, **PARTED))
    assert after[:140].all()
    assert not after[160:].any()


def test_a_brake_just_released_may_still_drag():
    drive = Drive()
    drive.go(30, brake_switch=1.0)
    after = coasts(drive.go(200, **PARTED))
    assert not after[:10].any()
    assert after[100:140].all()


def test_a_clutch_that_slips_in_a_launch_is_no_coasting():
    drive = Drive()
    drive.go(100, **CREEPING)
    assert not coasts(drive.go(50, **NEUTRAL)).any()
    drive.go(60)  # closed for the first time: what follows is a shift
    assert coasts(drive.go(30, **PARTED)).all()


def test_after_a_gap_a_standstill_is_unknown():
    drive = Drive()
    drive.go(10)
    assert not coasts(drive.go(300, gap=True, **PARTED)).any()


def test_where_the_ratio_or_the_engine_is_unknown_coasting_stands():
    drive = Drive()
    assert coasts(drive.go(30, **(PARTED | {"gear_ratio": NAN, "gear": 0.0}))).all()
    assert coasts(drive.go(30, **(PARTED | {"engine_speed": NAN}))).all()


def test_without_the_signal_there_is_none():
    signals = {role: value for role, value in DRIVING.items() if role != "driveline_engaged"}
    assert not coasts(Drive(signals).go(30, shift_in_process=1.0)).any()


def test_any_cut_gives_the_same():
    def stretches(drive, cut):
        parts = []
        for n, changes in (
            (60, {}),
            (45, PARTED),
            (20, {}),
            (30, {"brake_switch": 1.0}),
            (150, PARTED),
            (9, {}),
        ):
            while n > 0:
                parts.append(drive.go(min(n, cut), **changes))
                n -= cut
        return [
            np.concatenate([getattr(p, name) for p in parts]) for name in ("coasting_N", "rotating_mass_kg")
        ]

    whole = stretches(Drive(), 1000)
    for cut in (1, 7):
        for one, other in zip(whole, stretches(Drive(), cut), strict=True):
            np.testing.assert_array_equal(one, other)


def test_where_a_released_pedal_stands_for_the_brake_it_marks_coasting():
    signals = {role: value for role, value in DRIVING.items() if not role.startswith("brake")}
    assert not coasts(Drive(signals).go(30, **PARTED)).any()
    drive = Drive(signals, gates={"brake": {"assume_when_pedal_released": True}})
    assert coasts(drive.go(30, **PARTED)).all()
    assert not coasts(drive.go(30, accelerator=0.0, **PARTED)).any()


@pytest.mark.parametrize("gate", ["brake", "turning", "retarder"])
def test_what_acts_rules_coasting_out_though_its_gate_is_disabled(gate):
    acts = {
        "brake": {"brake_switch": 1.0},
        "turning": {"yaw_rate": 0.3},
        "retarder": {"retarder_torque_pct": -40.0},
    }
    drive = Drive(gates={gate: {"enabled": False}})
    assert not coasts(drive.go(30, **PARTED, **acts[gate])).any()
    assert coasts(drive.go(30, **PARTED)).any()


def test_a_speed_that_its_sender_smooths_shows_no_coasting():
    drive = Drive()
    lost = drive.go(30, output_shaft_speed=NAN, **PARTED)
    assert np.isfinite(lost.raw_speed_mps[5:]).all()  # the undriven axle's
    assert not coasts(lost).any()
