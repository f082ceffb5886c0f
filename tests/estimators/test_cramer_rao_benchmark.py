"""The bound of `benchmarks/cramer_rao.py` is the inverse of the information, where that is a formula."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core.samples import GRAVITY_MPS2, STEP_S

from .benchmark_modules import benchmark

cramer_rao = benchmark("cramer_rao")
bound = benchmark("cramer_rao_bound")

N, MASS_KG = 400, 20_000.0


def truth(bound, **columns):
    """Return a standing road under a force in pulses, nothing else unknown but what `columns` say."""
    pulses = np.where(np.arange(N) % 100 < 50, 12_000.0, 2_000.0)
    none, ones = np.zeros(N), np.ones(N)
    flat = {
        "metres": none, "by_u": pulses, "by_torque": none, "by_friction": none, "by_delay": none,
        "by_wind": none, "rotating": ones, "keeps": ones, "keeps_friction": ones,
        "known": ones > 0.0, "curved": none > 0.0,
    }  # fmt: skip
    return bound.Truth(mass_kg=MASS_KG, **flat | columns)


def test_it_is_the_inverse_of_the_information_of_all_samples(bound):
    found = truth(bound)
    mass, grade = bound.bounds(found, accelerometer=False, told=True)
    since_s = STEP_S * np.arange(1, N + 1)
    rows = np.stack([np.ones(N), -GRAVITY_MPS2 * since_s, np.cumsum(found.by_u) * STEP_S], 1)
    states = [bound.V, bound.GRADE, bound.U]
    prior = np.diag(bound.prior())[states]
    scale = np.sqrt(prior)  # 1/kg and m/s differ by ten orders
    information = (rows * scale).T @ (rows * scale) / bound.SPEED_VAR + np.eye(3)
    std = np.sqrt(np.diag(np.linalg.inv(information))) * scale
    assert mass[-1] == pytest.approx(std[2] * MASS_KG, rel=1e-4)
    assert grade[-1] == pytest.approx(std[1], rel=1e-4)


def test_what_is_unknown_as_well_makes_it_wider_and_an_accelerometer_narrower(bound):
    alone = bound.bounds(truth(bound), accelerometer=False, told=True)[0][-1]
    torque = truth(bound, by_torque=np.full(N, 10.0 / MASS_KG), keeps=np.full(N, 0.99))
    wider = bound.bounds(torque, accelerometer=False, told=True)[0][-1]
    helped = bound.bounds(torque, accelerometer=True, told=True)[0][-1]
    assert alone < helped < wider


def test_who_is_not_told_where_a_straight_road_is_curved_knows_less(bound):
    straight = truth(bound, metres=np.full(N, 0.4))
    told, untold = (bound.bounds(straight, accelerometer=False, told=told) for told in (True, False))
    assert told[0][-1] < untold[0][-1]
    assert told[1][-1] < untold[1][-1]


def test_without_a_known_force_no_mass_is_learned(bound):
    unknown = truth(bound, known=np.zeros(N, np.bool_))
    mass, _ = bound.bounds(unknown, accelerometer=False, told=True)
    before = np.sqrt(bound.prior()[bound.U, bound.U]) * MASS_KG
    assert mass[-1] == pytest.approx(before, rel=1e-9)


def test_a_driveline_is_at_rest_a_while_after_it_opens_until_it_is_about_to_close(bound):
    coasts = np.zeros(60, np.bool_)
    coasts[10:40] = True
    coasts[45:55] = True  # too short
    assert np.flatnonzero(bound.at_rest(coasts)).tolist() == list(range(16, 32))


def test_a_road_is_no_steeper_than_is_asked_and_curved_where_it_says(bound):
    road = bound.draw_road(np.random.default_rng(1), 0.02)
    assert np.abs(road.sine).max() <= 0.02 + abs(road.sine[0])
    bends = np.abs(np.diff(road.sine))
    assert bends[~road.curved[1:]].std() < bends[road.curved[1:]].std()
    assert 0.0 < road.curved.mean() < 1.0


def test_the_table_marks_what_is_beyond_twice_the_bound(cramer_rao):
    def run(mass):
        return {
            "driver": "pulses", "seed": 1, "mass": mass, "mass bound": 1.0, "mass linear": 1.0,
            "mass at once": 1.0, "grade": 1.0, "grade bound": 1.0, "grade linear": 1.0, "grade at once": 1.0,
        }  # fmt: skip

    def runs(mass, estimator):
        about = [{"accelerometer": has, "part": part} for has in (False, True) for part in range(3)]
        return [run(mass) | {"estimator": estimator} | one for one in about]

    rows = cramer_rao.compared(runs(9.0, "any"))
    assert "| **3.00** | 3.00 |" in cramer_rao.table(rows)[2]
    assert "mass in 0, grade in 6 of 6 rows" in cramer_rao.summary(rows)
    names = [variant.name for variant in cramer_rao.ESTIMATORS]
    lines = cramer_rao.tables([*runs(4.0, names[0]), *runs(9.0, names[1])])
    assert [line for line in lines if line.startswith("## ")] == [f"## {name}" for name in names]
    assert sum("mass in 6, grade in 6 of 6 rows" in line for line in lines) == 1


def test_who_is_told_that_the_load_is_steady_has_no_drift(cramer_rao):
    drawn, _ = cramer_rao.scenario("pulses", 3)
    drawn["duration_s"] = 40.0
    drive = cramer_rao.exact(cramer_rao.prepare(drawn))
    assert np.isnan(drive.samples.altitude_m).all()
    assert (drive.facts.torque_accuracy, drive.facts.slips) == (0.0, False)
    stds = []
    for variant in cramer_rao.ESTIMATORS:
        estimates, _ = cramer_rao.estimate_with(variant.make, drive, 21000.0, accelerometer=False)
        stds.append(float(estimates.mass_std_kg[-1]))
    assert stds[0] != stds[1]
