"""Each gate closes on its cause and says its name; dwell, precedence, and what never closes one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from vehicle_helpers import FINAL_DRIVE, RADIUS_M, config, ticks

from canest.core.gates import Gate
from canest.core.samples import ModelBlock
from canest.pipeline.build import model_spec
from canest.vehicle.filtered_model import FilteredModel

V = 15.0
SHAFT_RPM = V / RADIUS_M * FINAL_DRIVE * 30 / math.pi
DRIVING: dict[str, Any] = {
    "engine_torque_pct": 40.0,
    "engine_speed": SHAFT_RPM,
    "output_shaft_speed": SHAFT_RPM,
    "gear_ratio": 1.0,
    "gear": 4.0,
    "shift_in_process": 0.0,
    "driveline_engaged": 1.0,
    "lockup_engaged": 1.0,
    "clutch_slip": 0.0,
    "clutch_switch": 0.0,
    "vehicle_speed": V,
    "undriven_speed": V,
    "brake_switch": 0.0,
    "brake_pedal": 0.0,
    "parking_brake": 0.0,
    "abs_active": 0.0,
    "retarder_torque_pct": 0.0,
    "accelerator": 30.0,
    "pto_state": 0.0,
    "yaw_rate": 0.0,
    "longitudinal_accel": 0.1,
    "ambient_temperature": 15.0,
}
REQUIRED_FOR_FORCE = {"engine_torque_pct"}


LASTING = {"BRAKE", "RETARDER", "PTO", "TURNING", "REVERSE"}


class Drive:
    """Ticks one stretch after another; starts where the dwell after the start is over."""

    def __init__(self, signals: dict[str, Any] | None = None, **more: Any) -> None:
        self.signals = DRIVING if signals is None else signals
        self.regression = FilteredModel(model_spec(config(list(self.signals), **more)))
        self.next = 0
        self.go(100)

    def go(self, n: int, stale: Any = (), gap: bool = False, **changes: Any) -> ModelBlock:
        values = self.signals | changes
        continues = self.next > 0 and not gap
        if gap:
            self.next += 1000
        block = ticks(values, n, self.next, continues=continues, stale=stale)
        self.next += n
        return self.regression.process(block)


def names(block: ModelBlock) -> set[str]:
    return {Gate(g).name for g in block.gate}


def test_a_truck_that_drives_is_open() -> None:
    assert names(Drive().go(50)) == {"OPEN"}


SPEEDS = ("output_shaft_speed", "engine_speed", "vehicle_speed", "undriven_speed")
CREEPING = dict.fromkeys(SPEEDS[:2], SHAFT_RPM / 15) | dict.fromkeys(SPEEDS[2:], 1.0)
CAUSES = [
    ("REVERSE", {"gear": -1.0, "gear_ratio": 8.0, "engine_speed": 8 * SHAFT_RPM}),
    ("LOW_SPEED", CREEPING),
    ("BRAKE", {"brake_switch": 1.0}),
    ("BRAKE", {"brake_pedal": 1.2}),
    ("BRAKE", {"parking_brake": 1.0}),
    ("BRAKE", {"abs_active": 1.0}),
    ("SHIFT", {"shift_in_process": 1.0}),
    ("DRIVELINE", {"driveline_engaged": 0.0}),
    ("DRIVELINE", {"lockup_engaged": 0.0}),
    ("DRIVELINE", {"clutch_switch": 1.0}),
    ("DRIVELINE", {"clutch_slip": 6.0}),
    ("DRIVELINE", {"engine_speed": SHAFT_RPM * 1.2}),
    ("PTO", {"pto_state": 5.0}),
    ("TURNING", {"yaw_rate": 0.08}),
    ("TURNING", {"yaw_rate": -0.08}),
    ("IMPLAUSIBLE", {"vehicle_speed": 20.0}),
    ("IMPLAUSIBLE", {"undriven_speed": 10.0}),
    ("INVALID", {"engine_torque_pct": math.nan}),
    ("INVALID", {"engine_torque_pct": 1e300}),
    ("INVALID", dict.fromkeys(SPEEDS, math.nan)),
    ("RETARDER", {"retarder_torque_pct": -3.0}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "cause"), CAUSES, ids=[f"{n}-{next(iter(c))}" for n, c in CAUSES])
def test_a_cause_closes_its_gate_at_once_and_by_name(name: str, cause: dict[str, float]) -> None:
    drive = Drive()
    closed = drive.go(20, **cause)
    # a ratio that changes is a shift for one tick, a speed that jumps is implausible as long as it moves
    assert names(closed) - {"SHIFT", "IMPLAUSIBLE"} == {name} - {"SHIFT", "IMPLAUSIBLE"}
    assert Gate[name] in closed.gate
    assert (closed.gate != Gate.OPEN).all()


@pytest.mark.parametrize(("name", "cause"), CAUSES, ids=[f"{n}-{next(iter(c))}" for n, c in CAUSES])
def test_a_gate_that_is_switched_off_ignores_its_cause(name: str, cause: dict[str, float]) -> None:
    off = {g: {"enabled": False} for g in {name.lower(), "shift", "implausible", "driveline"}}
    if name == "INVALID":  # switched off or not, there is no number to learn from
        return
    assert name not in names(Drive(gates=off).go(20, **cause))


@pytest.mark.parametrize("role", sorted(set(DRIVING) - REQUIRED_FOR_FORCE))
def test_an_optional_role_closes_nothing_by_being_silent_or_not_there(role: str) -> None:
    assert names(Drive().go(30, stale=[role])) == {"OPEN"}
    assert names(Drive().go(30, **{role: math.nan})) == {"OPEN"}
    without = {r: v for r, v in DRIVING.items() if r != role}
    assert names(Drive(without).go(30)) == {"OPEN"}


@pytest.mark.parametrize("role", ["engine_torque_pct", "ambient_temperature"])
def test_a_required_role_that_goes_silent_is_stale(role: str) -> None:
    drive = Drive(required=["ambient_temperature"])
    assert names(drive.go(30, stale=[role])) == {"STALE"}


def test_speeds_that_all_go_silent_are_stale() -> None:
    speeds = ["output_shaft_speed", "engine_speed", "vehicle_speed", "undriven_speed"]
    assert names(Drive().go(30, stale=speeds[:3])) == {"OPEN"}
    assert names(Drive().go(30, stale=speeds)) == {"STALE"}


def test_a_ratio_that_goes_silent_is_stale_where_nothing_else_gives_it() -> None:
    block = Drive().go(30, stale=["gear_ratio", "gear", "engine_speed"])
    assert names(block) == {"STALE"}


def test_a_changed_ratio_is_a_shift() -> None:
    drive = Drive()
    block = drive.go(3, gear=3.0, gear_ratio=2.0, engine_speed=2 * SHAFT_RPM)
    assert [Gate(g).name for g in block.gate] == ["SHIFT", "RECOVERY", "RECOVERY"]


def test_several_causes_name_the_first_in_order_of_precedence() -> None:
    causes: dict[str, float] = {}
    drive = Drive()
    for name, cause in reversed([c for c in CAUSES if c[0] in LASTING]):
        causes |= cause
        assert Gate[name] in drive.go(20, **causes).gate[1:]
        assert {Gate(g) for g in drive.go(20, **causes).gate} == {Gate[name]}
    assert names(drive.go(20, stale=["engine_torque_pct"], **causes)) == {"STALE"}


@pytest.mark.parametrize(("recovery_s", "dwell"), [(0.0, 0), (0.02, 0), (0.04, 1), (1.0, 49), (2.5, 124)])
def test_the_dwell_after_a_cause_is_as_long_as_configured(recovery_s: float, dwell: int) -> None:
    drive = Drive(gates={"brake": {"recovery_s": recovery_s}})
    drive.go(10, brake_switch=1.0)
    gate = drive.go(200).gate
    # the first open tick is `recovery_s` after the last closed one
    assert (gate[:dwell] == Gate.RECOVERY).all()
    assert (gate[dwell:] == Gate.OPEN).all()


def test_the_longest_dwell_counts() -> None:
    drive = Drive(gates={"brake": {"recovery_s": 2.0}, "turning": {"recovery_s": 0.1}})
    drive.go(1, brake_switch=1.0)
    drive.go(1, yaw_rate=0.2)
    gate = drive.go(200).gate
    assert int((gate == Gate.RECOVERY).sum()) == 98


def test_after_a_gap_the_filters_settle_first() -> None:
    drive = Drive(gates={"stale": {"recovery_s": 0.5}})
    block = drive.go(60, gap=True)
    assert (block.gate[:25] == Gate.RECOVERY).all()
    assert (block.gate[25:] == Gate.OPEN).all()


def test_restart_marks_the_first_open_sample() -> None:
    drive = Drive()
    assert not drive.go(20).restart.any()
    assert not drive.go(5, brake_switch=1.0).restart.any()
    block = drive.go(100)
    assert np.flatnonzero(block.restart).tolist() == [np.flatnonzero(block.gate == 0)[0]]


def test_a_pedal_that_is_up_counts_as_braking_where_no_brake_is_reported() -> None:
    gates = {"brake": {"assume_when_pedal_released": True}}
    assert names(Drive(gates=gates).go(20)) == {"OPEN"}
    assert names(Drive(gates=gates).go(20, accelerator=0.0)) == {"BRAKE"}
    assert names(Drive(gates=gates).go(20, accelerator=math.nan)) == {"BRAKE"}
    assert names(Drive().go(20, accelerator=0.0)) == {"OPEN"}
    gates["brake"]["pedal_pct"] = 50.0  # of the other pedal
    assert names(Drive(gates=gates).go(20)) == {"OPEN"}


def test_lateral_acceleration_where_there_is_no_yaw_rate() -> None:
    signals = {r: v for r, v in DRIVING.items() if r != "yaw_rate"} | {"lateral_accel": 0.0}
    assert names(Drive(signals).go(20, lateral_accel=-1.1)) == {"TURNING"}
    assert names(Drive(signals).go(20, lateral_accel=0.9)) == {"OPEN"}


def test_lateral_acceleration_where_the_yaw_rate_is_missing() -> None:
    signals = {**DRIVING, "lateral_accel": 0.0}
    assert names(Drive(signals).go(20, yaw_rate=math.nan, lateral_accel=-1.1)) == {"TURNING"}
    assert names(Drive(signals).go(20, lateral_accel=-1.1)) == {"OPEN"}


def test_low_excitation_closes_for_those_who_want_it_and_only_for_them() -> None:
    gates = {"low_excitation": {"enabled": True, "window_s": 2.0}}
    wobble = 40 + 30 * np.sin(np.arange(300) / 10)
    drive = Drive(gates=gates)
    assert names(drive.go(50)) == {"LOW_EXCITATION"}
    assert set(drive.go(300, engine_torque_pct=wobble).gate[100:]) == {Gate.OPEN}
    assert set(drive.go(2000).gate[-500:]) == {Gate.LOW_EXCITATION}
    assert names(Drive().go(300)) == {"OPEN"}


UNREPORTED = {k: v for k, v in DRIVING.items() if k not in ("brake_switch", "brake_pedal", "accelerator")}
NO_TORQUE = {"engine_torque_pct": 5.0}  # as much as the friction takes


def test_without_brake_and_pedal_driving_without_propulsion_may_be_braking() -> None:
    drive = Drive(UNREPORTED)
    assert names(drive.go(20, **NO_TORQUE)) == {"POSSIBLE_BRAKE"}
    assert names(drive.go(20)) == {"RECOVERY"}
    assert names(drive.go(50)) == {"RECOVERY", "OPEN"}


def test_a_pressed_accelerator_is_no_braking_and_a_released_one_may_be() -> None:
    drive = Drive(UNREPORTED | {"accelerator": 30.0})
    assert names(drive.go(20, **NO_TORQUE)) == {"OPEN"}
    assert names(drive.go(20, accelerator=0.0)) == {"OPEN"}  # a cruise control drives it
    assert names(drive.go(20, accelerator=0.0, **NO_TORQUE)) == {"POSSIBLE_BRAKE"}
    assert names(drive.go(20, accelerator=math.nan, **NO_TORQUE)) == {"POSSIBLE_BRAKE"}
    gates = {"brake": {"assume_when_pedal_released": True}}
    assert names(Drive(UNREPORTED | {"accelerator": 30.0}, gates=gates).go(20, **NO_TORQUE)) == {"OPEN"}


@pytest.mark.parametrize("known", ["brake_switch", "brake_pedal", "accelerator"])
def test_where_a_brake_or_a_pressed_pedal_is_mapped_no_brake_is_supposed(known: str) -> None:
    drive = Drive(UNREPORTED | {known: DRIVING[known]})
    assert names(drive.go(20, **NO_TORQUE)) == {"OPEN"}


def test_a_grade_that_no_road_has_is_a_brake_nobody_reports() -> None:
    drive = Drive(UNREPORTED, gates={"implausible": {"enabled": False}})
    speed = 15.0 - 0.02 * 4.0 * np.arange(60)  # 4 m/s2 against 40 % torque
    changes = dict.fromkeys(SPEEDS[:2], SHAFT_RPM * speed / 15.0) | dict.fromkeys(SPEEDS[2:], speed)
    assert "POSSIBLE_BRAKE" in names(drive.go(60, **changes))
    assert "POSSIBLE_BRAKE" not in names(Drive(UNREPORTED).go(60))
