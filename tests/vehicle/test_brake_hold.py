"""A brake whose signal is lost while it acts."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from test_gating import Drive, names
from vehicle_helpers import config, ticks

from canest.core.samples import RATE_HZ
from canest.pipeline.build import model_spec
from canest.vehicle.brake_hold import HOLD_S, BrakeHold

ACTING = [
    ("brake_switch", 1.0),
    ("brake_pedal", 40.0),
    ("parking_brake", 1.0),
    ("abs_active", 1.0),
    ("retarder_torque_pct", -60.0),
]


@pytest.mark.parametrize(("role", "value"), ACTING)
@pytest.mark.parametrize("stale", [True, False])
def test_it_goes_on_until_it_is_received_again(role: str, value: float, stale: bool) -> None:
    drive = Drive(None)
    gate = "RETARDER" if "retarder" in role else "BRAKE"
    assert names(drive.go(20, **{role: value})) == {gate}
    lost = drive.go(500, stale=[role] if stale else [], **{role: math.nan})
    assert names(lost) == {gate}
    assert "OPEN" in names(drive.go(100, **{role: 0.0}))


def test_a_controller_that_stays_dead_brakes_no_more() -> None:
    drive = Drive(None)
    drive.go(20, brake_switch=1.0)
    assert "OPEN" in names(drive.go(round((HOLD_S + 5) * RATE_HZ), brake_switch=math.nan))


def test_a_clock_set_back_does_not_release_it() -> None:
    drive = Drive(None)
    drive.go(20, brake_switch=1.0)
    drive.next = -100_000
    assert names(drive.go(50, gap=True, brake_switch=math.nan)) == {"BRAKE"}
    drive.go(round(HOLD_S * RATE_HZ), brake_switch=math.nan)
    assert "OPEN" in names(drive.go(100, brake_switch=math.nan))


def test_one_that_is_lost_while_it_rests_closes_nothing() -> None:
    assert names(Drive(None).go(200, brake_switch=math.nan, retarder_torque_pct=math.nan)) == {"OPEN"}


def test_the_retarder_goes_on_with_the_torque_it_had() -> None:
    def force(**changes: float) -> float:
        drive = Drive(None, vehicle={"retarder": {"reference_torque_Nm": 1500, "location": "crank"}})
        drive.go(20, retarder_torque_pct=-60.0)
        return float(drive.go(5, **changes).raw_force_N[-1])

    assert force(retarder_torque_pct=math.nan) == force(retarder_torque_pct=-60.0)


def test_any_cut_fills_the_same() -> None:
    rng = np.random.default_rng(5)
    values = np.where(rng.random(900) < 0.6, np.nan, rng.choice([0.0, -50.0], 900))
    values[300:800] = np.nan
    roles = {"retarder_torque_pct": values}

    def filled(edges: list[int]) -> bytes:
        signals = ["retarder_torque_pct", "engine_torque", "vehicle_speed", "gear"]
        brakes = BrakeHold(model_spec(config(signals)))
        parts = []
        for a, b in pairwise(edges):
            block = ticks({r: v[a:b] for r, v in roles.items()}, b - a, first=a)
            parts.append(brakes.fill(block).values["retarder_torque_pct"])
        return np.concatenate(parts).tobytes()

    whole = filled([0, 900])
    assert filled(list(range(901))) == whole
    assert filled([0, 7, 299, 301, 550, 900]) == whole
