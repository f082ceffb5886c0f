"""Torque samples that no engine gives: zeros between others, a type's maximum; and real holes, which stay."""

from __future__ import annotations

from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canest.config import load_config, parse_config
from canest.core.frames import FrameBlock
from canest.demo import DRIVE
from canest.logs.format_detection import open_log
from canest.pipeline.build import intake_spec
from canest.pipeline.pipeline import Pipeline
from canest.vehicle import torque_dropout as module
from canest.vehicle.torque_dropout import TorqueDropoutCheck, torque_limits

EEC1_US = 20_000
PROVE = [60.0, 0.0, 60.0, 0.0]  # two dropouts


def passed(values, period_us=EEC1_US, screen=None):
    screen = screen or TorqueDropoutCheck(far=5.0, most=124.0)
    t_us = period_us * np.arange(1, len(values) + 1, dtype=np.int64)
    refused = screen.refused(t_us, np.array(values))
    return list(values) if refused is None else np.array(values)[~refused].tolist()


@pytest.mark.parametrize("period_us", [10_000, EEC1_US, 100_000])
@pytest.mark.parametrize("run", [1, 2, 3])
@pytest.mark.parametrize("torque", [60.0, -40.0])
def test_zeros_among_torques_are_refused_once_the_signal_has_shown_two(period_us, run, torque):
    cycle = [torque, torque + 1.0, *[0.0] * run]
    kept = passed(cycle * 12, period_us)
    assert kept == cycle * 2 + cycle[:2] * 10


@pytest.mark.parametrize("n", [1, 30])  # walked, and in columns
def test_the_hole_of_a_shift_stays(n):
    shift = [70.0, *[0.0] * 40, 65.0] * n
    assert passed(shift) == shift


def test_the_hole_of_a_shift_comes_three_reports_late_where_there_are_dropouts():
    assert passed([*PROVE, 60.0, *[0.0] * 40, 55.0]) == [*PROVE, 60.0, *[0.0] * 37, 55.0]


def test_a_pedal_let_go_for_one_row_of_a_table_at_1_Hz_stays():
    table = [60.0, 0.0] * 60
    assert passed(table, 1_000_000) == table


def test_torques_near_zero_may_reach_it_as_often_as_they_like():
    idling = [1.0, 0.0, 3.0, 0.0, -2.0] * 40
    assert passed(idling) == idling


def test_the_steps_of_a_coarse_signal_may_reach_zero_too():
    """What 9 N m would push here, 10 N m are far from zero; in steps of 10, even 30 may be a foot's doing."""
    van = load_config("class8").vehicle.model_copy(update={"mass_min_kg": 500.0})
    fine, coarse = (
        torque_limits(["engine_torque"], van, {}, steps)["engine_torque"]
        for steps in ({}, {"engine_torque": 10.0})
    )
    creeping = [20.0, 10.0, 0.0, 10.0, 0.0, 10.0] * 40
    assert passed(creeping, 100_000, TorqueDropoutCheck(*fine)) != creeping
    assert passed(creeping, 100_000, TorqueDropoutCheck(*coarse)) == creeping
    assert coarse.far == 30.0


def test_a_zero_that_ends_somewhere_else_proves_nothing():
    falling = [60.0, 0.0, 20.0, 0.0, 60.0] * 40
    assert passed(falling) == falling


def test_dropouts_of_minutes_ago_prove_nothing():
    screen = TorqueDropoutCheck(far=5.0)
    assert passed([*PROVE, 60.0], screen=screen) == [*PROVE, 60.0]
    late = np.array([600_000_000, 600_020_000]), np.array([60.0, 0.0])
    assert screen.refused(*late) is None


def test_not_available_is_left_to_those_who_know_it():
    values = [*PROVE, 60.0, np.nan, 0.0, np.nan, 60.0]
    assert len(passed(values)) == len(values) - 1


@pytest.mark.parametrize("n", [3, 90])
def test_the_maximum_of_the_type_is_refused_at_once(n):
    assert passed([60.0] * n + [125.0, 60.0, -125.0]) == [60.0] * (n + 1)


@pytest.mark.parametrize(
    ("source", "end"),
    [
        ("engine_torque: {column: c, unit: Nm}", 32767.0),
        ("engine_torque: {column: c, unit: kNm}", 32767e3),
        ("engine_torque: {column: c, unit: Nm, scale: 0.1}", 32767 * 0.1),
        ("engine_torque_pct: {column: c}", 125.0),
        ("wheel_torque: {column: c, unit: Nm}", -32768.0),
    ],
)
def test_tables_too(source, end):
    config = parse_config(
        "vehicle: {mass_min_kg: 7000, mass_max_kg: 40000, wheel_radius_m: 0.5, final_drive: 3.7, "
        "gear_ratios: {1: 12, 2: 0.74}, drag_area_m2: 6, rolling_resistance: 0.006, "
        "reference_torque_Nm: 2100}\n"
        f"dbc: []\nsignals: {{{source}, vehicle_speed: {{column: v, unit: km/h}}}}\n"
    )
    (limit,) = intake_spec(config).torque.values()
    screen = TorqueDropoutCheck(*limit)
    assert passed([90.0, end, 91.0], screen=screen) == [90.0, 91.0]


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 150_000), st.sampled_from([0.0, 0.0, 2.0, 50.0, 60.0, 125.0, np.nan]))),
    st.lists(st.integers(0, 60)),
    st.sampled_from([0, 3, 50]),
)
def test_any_cut_refuses_the_same_samples(steps, cuts, few):
    t_us = np.cumsum([step for step, _ in steps], dtype=np.int64)
    values = np.array([value for _, value in steps])

    def refused(edges):
        screen, parts = TorqueDropoutCheck(far=5.0, most=124.0), []
        for a, b in pairwise(edges):
            found = screen.refused(t_us[a:b], values[a:b])
            parts.append(np.zeros(b - a, bool) if found is None else found)
        return np.concatenate([*parts, np.zeros(0, bool)]).tolist()

    with patch.object(module, "_FEW", 10**9):
        whole = refused([0, len(steps)])
    with patch.object(module, "_FEW", few):
        assert refused(sorted({0, len(steps), *(c for c in cuts if c < len(steps))})) == whole


# -- whole drives --------------------------------------------------------------------------------------

CONFIG = load_config("class8")
FRAMES = FrameBlock.concatenate(list(open_log(DRIVE)))


def masses(frames):
    pipeline = Pipeline(CONFIG)
    return float(pipeline.push(frames).mass_kg[-1]), pipeline.intake.range_rate_check.refused


@pytest.mark.parametrize("raw", [125, 250])
def test_a_tenth_of_the_torque_reports_at_zero_or_full_scale_does_not_bend_the_mass(raw):
    sane_kg, refused = masses(FRAMES)
    assert not refused
    torque = np.flatnonzero((FRAMES.can_id & 0x1FFFFFFF) == 0x0CF00400)
    rng = np.random.default_rng(1)
    hurt = torque[rng.random(len(torque)) < 0.1]
    data = FRAMES.data.copy()
    data[hurt] = data[hurt] & ~np.uint64(0xFF << 16) | np.uint64(raw << 16)
    mass_kg, refused = masses(FrameBlock(FRAMES.t_us, FRAMES.can_id, FRAMES.length, data))
    assert mass_kg == pytest.approx(sane_kg, rel=0.01)
    assert refused["engine_torque_pct"] > 0.3 * len(hurt)


def test_the_ends_of_a_type_have_the_offset_of_their_column():
    van = load_config("class8").vehicle
    limit = torque_limits(["engine_torque"], van, {"engine_torque": (0.1, -100.0)}, {})["engine_torque"]
    assert 32767 * 0.1 - 100.0 in limit.ends
