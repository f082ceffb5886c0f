"""Coasting with an open driveline tells the slope, whatever the vehicle weighs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core import jit
from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, Status
from canest.estimators.canest_0_1 import lines
from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.coast import (
    DRAGS_MPS2,
    coasted_here,
    doubt_road,
    note,
    roll_back,
    rolling_grade,
    shows,
)
from canest.estimators.canest_0_1.estimator import Canest
from canest.estimators.canest_0_1.filter import OUTLIER
from canest.estimators.canest_0_1.lines import COLUMNS, EARLY, MOST_MPS2, SETTLES, CoastLines

from .momentum import flat, hills, pulses, trip
from .synthetic import FACTS
from .test_version_0_1_drives import degrees, replace_block, run
from .test_version_0_1_filter import Dense, h, random_gaussian, redrawn

N = 240
WINDOW_ENDS = np.array([k for k in range(16, N) if (k + 1001) % 10 == 0])


def samples(spans, accel=-0.37, noise=0.005, seed=0, curve=0.0, held=1):
    """Ticks 1000 .. 1239 of a vehicle that coasts in `spans`: the rows that `CoastLines` takes."""
    rng = np.random.default_rng(seed)
    t = np.arange(N) * 0.02
    speed = 12.0 + accel * t + 0.5 * curve * (t - 1.5) ** 2 + noise * rng.standard_normal(N)
    speed = speed[np.arange(N) // held * held]
    force = np.full(N, np.nan)
    for a, b in spans:
        force[a:b] = -500.0 - np.arange(b - a)
    return np.stack([1000.0 + np.arange(N), force, np.full(N, 520.0), speed])


def lines_of(rows, cuts=()):
    """Push the rows in blocks, each with the 15 samples before it; return lines by window."""
    lines, found = CoastLines(), []
    for a, b in zip((0, *cuts), (*cuts, N), strict=True):
        past = min(a, 15)
        ends = WINDOW_ENDS[(a <= WINDOW_ENDS) & (b > WINDOW_ENDS)] - (a - past)
        found.append(lines.push(past, rows[:, a - past : b], ends))
    return np.concatenate(found, axis=1)


def test_a_line_is_the_least_squares_one():
    rows = samples([(50, 95)])
    found = lines_of(rows)
    (at,) = np.flatnonzero(np.isfinite(found[0]))
    taken = np.arange(50 + SETTLES, 95 - EARLY)
    slope, _ = np.polyfit(taken * 0.02, rows[3, taken], 1)
    line = dict(zip(COLUMNS, found[:, at], strict=True))
    assert line["coast_mps2"] == pytest.approx(slope, abs=1e-9)
    assert line["coast_N"] == pytest.approx(rows[1, taken].mean())
    assert line["coast_kg"] == 520.0
    assert WINDOW_ENDS[at] == 99  # the first window that ends after it
    assert line["coast_back_s"] == pytest.approx((99 - taken.mean()) * 0.02)


def test_its_variance_covers_the_error():
    errors, stds = [], []
    for seed in range(300):
        found = lines_of(samples([(50, 95)], seed=seed))
        (at,) = np.flatnonzero(np.isfinite(found[0]))
        errors.append(found[0, at] + 0.37)
        stds.append(np.sqrt(found[1, at]))
    z = np.array(errors) / np.array(stds)
    assert np.mean(np.abs(z) < 2) > 0.93
    # wider than white noise asks for: what bends a little may be a driveline that is not at rest
    assert np.std(errors) < np.median(stds) < 4 * np.std(errors)


def test_what_bends_is_less_sure():
    straight = lines_of(samples([(50, 95)]))
    bent = lines_of(samples([(50, 95)], curve=1.0))
    at = np.flatnonzero(np.isfinite(bent[0]))
    assert bent[1, at] > 20 * straight[1, at]


def test_a_coasting_too_short_gives_no_measurement():
    assert np.isnan(lines_of(samples([(50, 50 + SETTLES + EARLY + 4)]))).all()


def test_a_speed_that_is_sent_rarely_counts_as_often_as_it_is_sent():
    assert np.isnan(lines_of(samples([(50, 95)], held=10))).all()  # 5 Hz: three values in half a second
    often = lines_of(samples([(50, 125)], held=5, noise=0.0))
    (at,) = np.flatnonzero(np.isfinite(often[0]))
    assert often[0, at] == pytest.approx(-0.37, abs=0.02)


def test_a_long_coasting_gives_one_line_after_another():
    found = lines_of(samples([(20, 230)]))
    (at,) = np.nonzero(np.isfinite(found[0]))
    assert len(at) == 4
    assert found[0, at] == pytest.approx([-0.37] * 4, abs=0.03)


@pytest.mark.parametrize("lag_s", [0.05, 0.1, 0.2, 0.3, 0.5])
def test_a_smoothed_speed_is_covered(lag_s):
    """Its sender's filter still carries the pull of the gear before (1 m/s2) into the coasting."""
    rows = samples([(50, 95)], noise=0.002)
    accel = np.where(np.arange(N) < 50, 1.0, -0.37)
    true = 12.0 + np.cumsum(accel) * 0.02
    smooth = np.empty(N)
    smooth[0] = true[0]
    for i in range(1, N):
        smooth[i] = smooth[i - 1] + (true[i] - smooth[i - 1]) * 0.02 / (lag_s + 0.02)
    rows[3] += smooth - samples([(50, 95)], noise=0.0)[3]
    found = lines_of(rows)
    (at,) = np.flatnonzero(np.isfinite(found[0]))
    assert abs(found[0, at] + 0.37) < 2.5 * np.hypot(np.sqrt(found[1, at]), DRAGS_MPS2)


@pytest.mark.parametrize("by", [3, 500, 200_000, 4_000_000])
def test_a_clock_set_back_ends_a_line_without_a_trace(by):
    rows = samples([(50, 95), (120, 170)])
    rows[0, 85:] -= by
    ends = np.array([k for k in range(16, N) if (rows[0, k] + 1) % 10 == 0 and not 85 <= k < 101])
    lines = CoastLines()
    found = lines.push(0, rows, ends)
    known = np.isfinite(found[0])
    assert known.any()
    assert found[0, known] == pytest.approx(-0.37, abs=0.05)
    assert (np.abs(found[4, known]) < 2.0).all()


def test_missing_ticks_end_a_line():
    rows = samples([(50, 110)])
    rows[0, 80:] += 300
    found = lines_of(rows)
    (at,) = np.nonzero(np.isfinite(found[0]))
    taken = np.arange(50 + SETTLES, 80 - EARLY)
    assert found[0, at[0]] == pytest.approx(np.polyfit(taken * 0.02, rows[3, taken], 1)[0], abs=1e-9)


@pytest.mark.parametrize("spans", [[(50, 95)], [(20, 230)], [(30, 60), (63, 100), (110, 112), (150, 200)]])
def test_any_cut_gives_the_same_bits(spans):
    rows = samples(spans)
    whole = lines_of(rows)
    assert np.isfinite(whole[0]).any()
    for cuts in (tuple(range(1, N)), (55, 61, 90, 94, 96), (100,)):
        np.testing.assert_array_equal(lines_of(rows, cuts), whole)


@pytest.mark.skipif(not jit.available(), reason="numba is an extra")
def test_compiled_gives_the_same_bits():
    rows = samples([(30, 60), (63, 100), (150, 230)])
    interpreted = lines_of(rows)
    jit.enable(True)
    try:
        np.testing.assert_array_equal(lines_of(rows, (40, 70)), interpreted)
    finally:
        jit.enable(False)


@pytest.mark.parametrize("seed", range(30))
def test_samples_that_are_not_visited_would_change_nothing(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    spans = [
        (int(a), min(int(a + rng.integers(1, 80)), N)) for a in rng.integers(0, N - 20, rng.integers(1, 6))
    ]
    rows = samples(spans, seed=seed, held=int(rng.integers(1, 3)))
    jump = int(rng.integers(20, N - 5))
    rows[0, jump:] += rng.integers(-300, 300) * (rng.random() < 0.5)
    cuts = tuple(int(c) for c in np.sort(rng.choice(np.arange(1, N), rng.integers(0, 30), replace=False)))
    found = [lines_of(rows, c) for c in ((), cuts, tuple(range(1, N)))]
    monkeypatch.setattr(lines, "worth_visiting", lambda past, t, f, e, b: np.arange(float(past), len(f)))
    every = lines_of(rows)
    for one in found:
        np.testing.assert_array_equal(one, every)


@pytest.mark.parametrize("size", [1.0, 30.0, 1e6, 1e160, 1e300, np.inf, np.nan])
def test_outliers_of_speed_give_no_line_or_a_possible_one(size):
    rng = np.random.default_rng(1)
    for row in (1, 2, 3):
        rows = samples([(20, 230)])
        hit = rng.random(N) < 0.1
        with np.errstate(over="ignore", invalid="ignore"):
            rows[row, hit] += size * rng.standard_normal(hit.sum())
        with np.errstate(all="ignore"):
            found = lines_of(rows)
        known = np.isfinite(found[0])
        assert (np.abs(found[0, known]) <= MOST_MPS2).all()
        assert np.isfinite(found[1, known]).all()


def remembered(accel, std, force, wheels, back_m):
    memory = [0.0] * at.MEMORY
    assert note(memory, accel, std * std, force, wheels, back_m)
    return memory


@pytest.mark.parametrize("road", [at.STRAIGHT, at.CURVED])
def test_the_filter_takes_it_as_a_dense_one_would(road):
    """a (1 + u J) = u F - g mu - g (theta - d kappa) - c omega, solved for the noise."""
    dense = Dense(Canest("canest-0.1", FACTS), road)
    dense.n = n = at.STATES
    dense.x, dense.P = random_gaussian(np.random.default_rng(4))
    if road == at.STRAIGHT:
        dense.x, dense.P = redrawn(dense.x, dense.P, 0.0)
    a, force, wheels, back_m, roll, drag, uneven = -0.4, -600.0, 520.0, 12.0, 0.06, 90.0, 1e-8
    lever = h(n, GRADE=GRAVITY_MPS2, CURVATURE=-GRAVITY_MPS2 * back_m, U=wheels * a - force, WIND=drag)
    x, P = list(dense.x), dense.P.tolist()
    told = roll_back(x, P, [0.0] * n, remembered(a, 0.02, force, wheels, back_m), roll, drag, uneven)
    noise = 0.02**2 + DRAGS_MPS2**2 + GRAVITY_MPS2**2 * uneven * back_m
    e, s = dense.correct(lever, -a - roll, noise)
    np.testing.assert_allclose(x, dense.x, rtol=1e-9)
    np.testing.assert_allclose(P, dense.P, rtol=1e-6, atol=1e-9)
    assert told == pytest.approx(-0.5 * (min(e * e / s, OUTLIER) + np.log(s)))


@pytest.mark.parametrize("wheels", [0.0, 520.0])
def test_on_a_slope_worked_out_by_hand(wheels):
    """20 t, no wind, 500 N of air, 3 % down: a (1 + J u) = g 0.03 - 0.06 - 0.025 m/s2."""
    u = 1 / 20_000.0
    a = (GRAVITY_MPS2 * 0.03 - 0.06 - 500.0 * u) / (1 + wheels * u)
    memory = remembered(a, 0.0, -500.0, wheels, 10.0)
    grade, var = rolling_grade(memory, u, 0.0, 0.0, 0.06, 100.0, 0.0, 0.0)
    assert grade == pytest.approx(-0.03)
    assert np.sqrt(var) == pytest.approx(DRAGS_MPS2 / GRAVITY_MPS2)
    _, var = rolling_grade(memory, u, (0.1 * u) ** 2, 0.0, 0.06, 100.0, 0.0, (2.0 * u) ** 2)
    # a tenth of the mass, and 2 m/s of wind at 100 N per m/s on 20 t, which is 0.01 m/s2
    doubts = np.hypot(0.1 * u * abs(-500.0 - wheels * a), 0.01)
    assert np.sqrt(var) * GRAVITY_MPS2 == pytest.approx(np.hypot(DRAGS_MPS2, doubts))
    here, _ = rolling_grade(memory, u, 0.0, 0.0, 0.06, 100.0, 2e-4, 0.0)
    assert here == pytest.approx(-0.03 + 10.0 * 2e-4)  # the middle of it was 10 m ago


@pytest.mark.parametrize("back_m", [np.nan, 150.0, -80_000.0])
def test_no_coasting_and_none_from_elsewhere_is_kept(back_m):
    memory = [0.0] * at.MEMORY
    accel = -0.3 if np.isfinite(back_m) else np.nan
    assert not note(memory, accel, 1e-4, -500.0, 520.0, back_m)
    assert memory == [0.0] * at.MEMORY
    assert not coasted_here(memory)


@pytest.mark.parametrize(("std", "shown"), [(0.01, True), (0.3, False)])
def test_a_coasting_with_little_information_is_no_measurement(std, shown):
    memory = remembered(-0.3, std, -500.0, 520.0, 5.0)
    assert coasted_here(memory)
    assert shows(memory) == shown


@pytest.mark.parametrize(("grade", "doubted"), [(0.01, False), (-0.02, True)])
def test_a_grade_that_cannot_be_gets_more_variance(grade, doubted):
    n = at.BASE_STATES
    x, P = [0.0] * n, np.diag([1e-12] * n).tolist()
    x[at.U], P[at.GRADE][at.GRADE] = 1 / 20_000.0, 0.002**2
    memory = remembered(-GRAVITY_MPS2 * grade - 0.06, 0.0, 0.0, 0.0, 0.0)
    doubt_road(x, P, memory, 0.06, 100.0)
    assert P[at.GRADE][at.GRADE] == pytest.approx(0.002**2 + (grade**2 if doubted else 0.0))
    assert x == [0.0, 1 / 20_000.0, *[0.0] * (n - 2)]


def rise(s):
    """Level, and 3 % from where the brakes are on."""
    return np.where(s > 480.0, 0.03, 0.0)


def launch(t, v):
    """Pulses, and after the stop all there is."""
    return pulses(t, v) if t < 50.0 else 0.85


def blind(drive):
    """The same drive by a gearbox that does not tell when the driveline is open."""
    return replace(drive, block=replace(drive.block, coasting_N=np.full(len(drive.block), np.nan)))


@pytest.mark.parametrize("load_kg", [15_000.0, 21_000.0])
def test_a_road_that_has_changed_under_the_brake_is_known_after_the_first_shift(load_kg):
    drive = trip(
        86,
        mass_kg=[(0.0, 27_000.0), (60.0, load_kg)],
        road=rise,
        throttle=launch,
        stops=[(40.0, 75.0)],
        shifts=[(79.0, 79.8)],
        start_mps=18.0,
    )
    _, seen = run(drive)
    _, unseen = run(blind(drive))
    after = slice(81 * 50, None)
    for e, least, most in ((seen, 0.0, 0.03), (unseen, 0.1, 1.0)):
        wrong = np.abs(drive.error(e)[after]).mean()
        assert least < wrong < most
    assert np.abs(degrees(drive, seen)[after]).max() < 0.2
    assert (np.abs(drive.error(seen) * drive.mass_kg)[after] < 2 * seen.mass_std_kg[after]).all()
    # the grade is given out while the gates are still closed
    recovery = slice(80 * 50, 80 * 50 + 18)
    assert (drive.block.gate[recovery] != 0).all()
    assert np.abs(degrees(drive, seen)[recovery]).max() < 0.3


def test_a_coasting_moves_the_grade_at_once_and_the_mass_when_gates_open():
    drive = trip(60, road=rise, start_mps=22.0, shifts=[(33.0, 33.8)])
    _, seen = run(drive)
    _, unseen = run(blind(drive))
    closed = drive.block.gate != 0
    first = int(np.flatnonzero(closed)[0])
    recovery = slice(33 * 50 + 42, 33 * 50 + 70)
    assert len(np.unique(seen.mass_kg[first + 10 : recovery.stop])) == 1
    assert np.abs(degrees(drive, seen)[recovery]).mean() < np.abs(degrees(drive, unseen)[recovery]).mean()
    np.testing.assert_array_equal(seen.mass_kg[: 33 * 50], unseen.mass_kg[: 33 * 50])
    assert seen.mass_kg[34 * 50 + 50] != unseen.mass_kg[34 * 50 + 50]


def test_a_launch_with_shifts_gives_several_measurements():
    shifts = [(4.0 + 3.0 * k, 4.8 + 3.0 * k) for k in range(4)]
    drive = trip(20, road=flat, throttle=lambda t, v: 0.85, start_mps=3.0, shifts=shifts)
    _, seen = run(drive)
    _, unseen = run(blind(drive))
    assert seen.status[-1] == Status.VALID
    assert unseen.status[-1] == Status.CONVERGING  # one stretch of 200 m: a crest may have begun on it
    assert abs(drive.error(seen)[-1]) < 0.02


@pytest.mark.parametrize("road", [flat, hills])
def test_coasting_for_long_measures_the_grade_all_the_time(road):
    drive = trip(100, road=road, shifts=[(60.0, 90.0)])
    coasting = slice(62 * 50, 90 * 50)
    for of, most in ((drive, 0.15), (blind(drive), 9.0)):
        _, e = run(of)
        wrong = np.sqrt(np.mean(degrees(drive, e)[coasting] ** 2))
        assert wrong < most
        z = (e.grade - drive.grade)[coasting] / e.grade_std[coasting]
        assert np.mean(np.abs(z) < 2) > 0.9
    if road is hills:
        assert wrong > 1.0  # who does not take it is lost
    assert (drive.block.gate[coasting] == Gate.SHIFT).all()


def test_a_wrongly_reported_driveline_is_not_valid_for_long():
    """It says open while the engine pulls: every coasting tells another slope."""
    drive = trip(120, road=flat)
    gate, force = drive.block.gate.copy(), np.full(len(drive.block), np.nan)
    for a in range(30 * 50, 110 * 50, 400):
        gate[a : a + 50], gate[a + 50 : a + 80], force[a : a + 50] = Gate.SHIFT, Gate.RECOVERY, -1000.0
    lie = replace_block(drive, gate=gate, coasting_N=force)
    lie.block = replace(lie.block, restart=np.concatenate(([True], (gate[1:] == 0) & (gate[:-1] != 0))))
    _, e = run(lie)
    wrong = np.abs(drive.error(e)) > 0.08
    assert np.mean(wrong & (e.status == 2)) < 0.05
