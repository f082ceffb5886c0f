"""What interrupts a drive: missing samples, stops, restarts. Nothing that was not seen may teach anything."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from canest.core.gates import Gate
from canest.core.samples import Status
from canest.estimators.default import hypotheses, joining, road_map
from canest.estimators.default import model as m
from canest.estimators.default.accelerometer import Comparison, compare
from canest.estimators.default.constants import CONSTANTS, vehicle_of
from canest.estimators.default.estimator import GaussianSum, _space
from canest.estimators.default.model import Window
from canest.estimators.default.report import Report, sum_over_nodes
from canest.estimators.windowing import WINDOW_S

from . import synthetic
from .momentum import FACTS, flat, steady, trip
from .test_canest_parts import mixture

NOTHING = Window(**dict.fromkeys(Window._fields, 0.0))


def with_gap(block, sample, seconds):
    t_us = block.t_us.copy()
    t_us[sample:] += round(seconds * 1e6)
    return replace(block, t_us=t_us)


@pytest.mark.parametrize("gap_s", [300, 3_600, 20_000, 80_000])
def test_after_a_gap_in_motion_no_wrong_mass_is_valid(gap_s):
    """The road of the missing hours is any road, and its variance has a bound: else only rounding is left."""
    drive = trip(150.0, road=flat, seed=2)
    estimates = GaussianSum("canest", FACTS).update(with_gap(drive.block, 3_000, gap_s))
    after = slice(3_000, None)
    wrong = np.abs(estimates.mass_kg[after] / drive.mass_kg[after] - 1.0) > 0.08
    assert not (wrong & (estimates.status[after] == Status.VALID)).any()
    assert np.nanmax(np.abs(estimates.grade[after])) < 0.1


def test_after_a_long_stop_no_height_is_known():
    """At the level of the sea as anywhere: the first altitude is no hill that has been climbed."""
    drive = trip(760.0, road=flat, throttle=steady, stops=[(60.0, 680.0)], altitude=True, seed=3).block
    ends = []
    for level_m in (10.0, 500.0):
        block = replace(drive, altitude_m=drive.altitude_m - drive.altitude_m[0] + level_m)
        ends.append(GaussianSum("canest", FACTS).update(block))
    np.testing.assert_allclose(ends[0].mass_kg[-1], ends[1].mass_kg[-1], rtol=1e-6)
    np.testing.assert_allclose(ends[0].grade[-1], ends[1].grade[-1], atol=1e-6)


def test_restarts_do_not_widen_the_mass():
    block = trip(200.0, road=flat, seed=2).block
    estimator = GaussianSum("canest", FACTS)
    estimator.update(block[:6_000])
    first = estimator.snapshot()
    known = first
    for _ in range(3):
        estimator = GaussianSum("canest", FACTS)
        estimator.restore(known["mass_kg"], known["mass_std_kg"])
        estimates = estimator.update(block[6_000:7_500])
        assert estimates.mass_std_kg[0] == pytest.approx(known["mass_std_kg"], rel=1e-6)
        known = estimator.snapshot()
    assert known["mass_std_kg"] == pytest.approx(first["mass_std_kg"], rel=0.05)


def test_a_mass_may_be_restored_as_exact():
    estimator = GaussianSum("canest", FACTS)
    estimator.restore(20_000.0, 0.0)
    estimates = estimator.update(trip(30.0, seed=2).block)
    assert np.isfinite(estimates.grade).all()
    assert np.isfinite(estimates.mass_kg).all()


@pytest.mark.parametrize("unseen_s", [30.0, 130.0, 600.0, 7_200.0])
def test_after_a_stop_that_nobody_saw_the_old_load_is_not_valid(unseen_s):
    """A restart in a depot: 30 t were saved, and 12 t drive off."""
    drive = trip(150.0, mass_kg=12_000.0, stops=[(0.0, 20.0)], seed=3)
    estimator = GaussianSum("canest", FACTS)
    estimator.restore(30_000.0, 900.0, unseen_s)
    estimates = estimator.update(drive.block)
    wrong = np.abs(drive.error(estimates)) > 0.08
    assert not (wrong & (estimates.status == Status.VALID)).any()
    assert (estimates.status[2_500:4_500] == Status.VALID).all()


def test_without_a_stop_some_seconds_of_driving_make_the_mass_valid():
    drive = trip(60.0, mass_kg=30_000.0, seed=3)
    estimator = GaussianSum("canest", FACTS)
    estimator.restore(30_000.0, 900.0)
    assert (estimator.update(drive.block).status[50 * 10 :] == Status.VALID).all()


def test_stops_one_after_the_other_leave_room_for_every_load():
    """Each opens a load, and 0.2 s of motion are too short for modes to exchange by themselves."""
    block = synthetic.drive(seconds=320.0, noise_mps2=0.02).block
    is_open = np.zeros(len(block), bool)
    is_open[20:30] = True
    for stop in range(1, 11):
        is_open[stop * 1_500 : stop * 1_500 + 10] = True
    gate = np.where(is_open, Gate.OPEN, Gate.LOW_SPEED).astype(np.uint8)
    estimator = GaussianSum("canest", synthetic.FACTS)
    for i in range(0, len(block), 10):
        estimator.update(replace(block, gate=gate, stopped=~is_open)[i : i + 10])
        assert estimator._carried.progress.alive <= m.LOADS * m.MODES


def test_a_gap_is_no_change_that_an_accelerometer_should_have_shown():
    comparison = Comparison()
    for sensed, accel, gap_s in [(0.78, 0.0, 0.0)] * 5 + [(1.3, 1.3, 60.0)] + [(1.3, 1.3, 0.0)] * 10:
        w = NOTHING._replace(sensed_mps2=sensed, accel_mps2=accel, speed_mps=10.0, gap_s=gap_s)
        comparison = compare.interpreted(comparison, w, vehicle_of(FACTS, 0.1, CONSTANTS))
    assert comparison.faulty == 0.0


def test_a_map_that_fits_after_a_gap_is_not_lost():
    road = road_map.RoadUse(right=0.985, trusted=True)
    given = Report(21_000.0, 1e4, 0.01, 1e-5)
    w = NOTHING._replace(road_sine=0.01, road_std=1e-3)
    road = road_map.follow_road.interpreted(road, given, w, 10_000.0, 0.0)
    assert road.lost == 0.0
    assert road.right > 0.9


@pytest.mark.parametrize("period_s", [0.0, 0.5, 1.0])
def test_a_right_map_is_kept_on_waves_however_slow_the_reports(period_s):
    """Its slope is that of the place where a window ends, and in a second waves of 630 m change by 0.5 %."""
    drive = trip(120.0, road=lambda s: 0.03 * np.sin(s / 100.0), seed=3)
    block = replace(drive.block, road_sine=np.sin(np.arctan(drive.grade)), road_std=np.full(6_000, 3e-4))
    estimator = GaussianSum("canest", replace(FACTS, has_road_map=True, report_period_s=period_s))
    parts = [estimator.update(block[i : i + 50]) for i in range(0, 6_000, 50)]
    mass_kg = np.concatenate([part.mass_kg for part in parts])
    assert estimator._carried.road.right > 0.95
    assert np.abs(mass_kg[3_000:] / drive.mass_kg[3_000:] - 1.0).max() < 0.03


def test_what_is_known_of_a_map_fades_where_it_has_no_road():
    """After 20 km it is that of a map of which nothing is known, 10 of 12; a distance is all that counts."""
    given, found = Report(21_000.0, 1e4, 0.01, 1e-5), []
    on, off = (NOTHING._replace(road_sine=sine, road_std=0.02) for sine in (0.01, np.nan))
    for part_m in (1.0, 100.0, 20_000.0):
        road = road_map.RoadUse(right=0.3)
        for _ in range(round(20_000.0 / part_m)):
            road = road_map.follow_road.interpreted(road, given, off, part_m, 0.0)
        found.append(road_map.follow_road.interpreted(road, given, on, 1.0, 0.0).right)
    np.testing.assert_allclose(found, found[0], rtol=1e-12)
    assert 0.83 < found[0] < 0.9


def test_a_slower_vehicle_after_a_gap_is_no_surprise():
    drive = synthetic.drive(seconds=160.0, noise_mps2=0.02).block
    speed = drive.speed_mps + 4.0 - drive.speed_mps[4_000:].min()
    speed[:4_000] += 50.0
    block = with_gap(replace(drive, speed_mps=speed, raw_speed_mps=speed), 4_000, 5.0)
    estimator = GaussianSum("canest", replace(synthetic.FACTS, slips=False))
    estimator.update(block[:4_000])
    for i in range(4_000, 4_100, 10):
        estimator.update(block[i : i + 10])
        assert estimator._carried.progress.surprise < 1.0


def test_a_stop_is_no_part_of_the_motion_after_it():
    """Standing windows wait; the first that moves, with a gate closed, must not take their mean."""
    q = joining.begin_sums.interpreted(0.0, 0.0)
    standing = NOTHING._replace(stopped=1.0)
    rolling = NOTHING._replace(sensed_mps2=0.7, distance_m=0.3, speed_mps=1.5, accel_mps2=0.7)
    for _ in range(50):
        q = joining.add_window.interpreted(q, standing, 0.0, False)
    q = joining.add_window.interpreted(q, rolling, 0.0, False)
    assert q.windows == 1.0
    assert q.sensed_mps2 == 0.7
    assert q.unseen_s == pytest.approx(50 * WINDOW_S)


def test_an_exchange_loses_nothing():
    """States that all densities share are the same after it, however small the parts that are left out."""
    mix, space = mixture(m.MODES, modes=list(range(m.MODES)))
    for d in range(m.MODES):
        mix.x[d, m.U], mix.P[d, m.U] = 1.0 / 20_000, 0.0
        mix.P[d, :, m.U] = 0.0
    chains = hypotheses.transitions.interpreted(4.0, 1.0, CONSTANTS)
    made = hypotheses.exchange.interpreted(mix, m.MODES, chains, CONSTANTS.least_weight, space)
    np.testing.assert_allclose(mix.x[:made, m.U], 1.0 / 20_000, rtol=1e-12)


@pytest.mark.parametrize("known_kg", [19_700.0, 20_000.0, 20_300.0])
def test_a_load_narrower_than_the_nodes_is_summed_as_it_is(known_kg):
    """Two loads, one of them known to 0.8 %: the sum over 48 nodes against one over 4,800."""
    estimator = GaussianSum("canest", FACTS)
    sums = []
    for fine in (1, 100):
        width = math.log(FACTS.mass_max_kg / FACTS.mass_min_kg)
        count = fine * len(estimator._nodes)
        nodes = np.exp((np.arange(count) + 0.5) * width / count) / FACTS.mass_max_kg
        space = _space(estimator._unknown, nodes.tolist())
        us, variances, shares = space.scratch.columns
        us[:2], shares[:2] = [1.0 / known_kg, 1.0 / 30_000.0], [0.7, 0.3]
        variances[:2] = [(0.008 / known_kg) ** 2, (0.25 / 30_000.0) ** 2]
        mean, var = sum_over_nodes.interpreted(2, 1.0, space)
        sums.append((mean, math.sqrt(var)))
    np.testing.assert_allclose(sums[0], sums[1], rtol=0.02)


def test_a_start_grade_is_a_slope_and_holds_once():
    """Height per distance, as it is given out; an hour later the road may be any."""
    drive = trip(40.0, road=flat)
    later = replace(drive.block, t_us=drive.block.t_us + 3_600_000_000)
    estimator = GaussianSum("canest", replace(FACTS, initial_mass_kg=15_000.0, initial_grade=0.2))
    assert estimator.update(drive.block).grade[0] == pytest.approx(0.2, abs=1e-12)
    begun = estimator.update(later[:60]).grade
    assert np.abs(begun).max() < 0.05


@pytest.mark.parametrize(("mps", "seconds"), [(0.3, 200.0), (1.5, 60.0)])
def test_a_load_that_is_tipped_while_creeping_leaves_no_old_mass_valid(mps, seconds):
    """A tipper before a paver: the old mass was valid meanwhile, and until 20 s after it."""
    loads = [(0.0, 32_000.0), (150.0 + 0.5 * seconds, 15_000.0)]
    drive = trip(300.0 + seconds, mass_kg=loads, road=flat, stops=[(150.0, 150.0 + seconds)], seed=4)
    t_s = drive.block.t_us * 1e-6
    creeps = (t_s >= 150.0) & (t_s < 150.0 + seconds)
    speeds = {
        name: np.where(creeps, slow, getattr(drive.block, name))
        for name, slow in (("speed_mps", mps), ("raw_speed_mps", mps), ("accel_mps2", 0.0))
    }
    block = replace(drive.block, stopped=drive.block.stopped & ~creeps, **speeds)
    estimates = GaussianSum("canest", FACTS).update(block)
    valid = estimates.status == Status.VALID
    assert valid[(t_s > 60.0) & (t_s < 135.0)].all()
    assert not (valid & (t_s > 60.0) & (np.abs(drive.error(estimates)) > 0.08)).any()
    assert valid[t_s > 180.0 + seconds].all()
