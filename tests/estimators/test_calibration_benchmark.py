"""Drives of `benchmarks/calibration.py` outside the priors are outside, and its page counts what misses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.simulation import simulate

from .benchmark_modules import benchmark

drives = benchmark("calibration_drives")
calibration = benchmark("calibration")

#: the estimator's delay of the torque before the first sample, s: mean and standard deviation
EXPECTED_DELAY_S = (0.08, 0.04)
SEEDS = range(200)


def outside(drives, name):
    return next(family for family in drives.OUTSIDE if family.name == name)


def scenario(family, seed=1):
    return family.scenario(np.random.default_rng(seed))


def drawn(family, effect, key):
    """Return what the drives of a family have of one undeclared effect, one number a seed."""
    found = []
    for seed in SEEDS:
        (entry,) = [e for e in scenario(family, seed)["undeclared"] if e["effect"] == effect]
        found.append(entry[key])
    return np.array(found)


def test_torque_gains_spread_as_stated_and_nothing_adds_to_them(drives, calibration):
    family = outside(drives, "torque gain*")
    gains = drawn(family, "torque_gain", "gain")
    assert gains.mean() == pytest.approx(1.0, abs=0.01)
    assert gains.std() == pytest.approx(drives.GAIN_STD, rel=0.15)
    assert not scenario(family)["small_errors"]
    drive = calibration.of_family(family, scenario(replace(family, duration_s=20)))
    assert drive.facts.torque_accuracy == drives.GAIN_STD
    others = drawn(outside(drives, "torque lag*"), "torque_gain", "gain")
    assert np.abs(others - 1.0).max() <= 0.02


def test_torque_acts_up_to_a_quarter_second_before_its_report(drives):
    family = outside(drives, "torque lag*")
    delays = drawn(family, "torque_delay", "delay_s")
    assert delays.min() == pytest.approx(0.0, abs=0.01)
    assert delays.max() == pytest.approx(drives.LONGEST_LAG_S, abs=0.01)
    assert delays.mean() == pytest.approx(drives.LONGEST_LAG_S / 2, abs=0.02)
    assert scenario(family)["sensors"]["torque_delay_s"] == 0.0
    mean, std = EXPECTED_DELAY_S
    assert np.mean(np.abs(delays - mean) > 2 * std) > 0.3


def test_a_rough_road_has_no_straight_and_power_at_all_wavelengths(drives):
    road = scenario(outside(drives, "rough road*"))["road"]
    at_m, grade = np.array(road["at_m"]), np.array(road["grade"])
    bend = np.abs(np.diff(grade, 2)) / np.diff(at_m)[0] ** 2
    straight_m = at_m[1:-1][bend > 1e-6]
    assert np.diff(straight_m).max() < 50.0
    assert drives.ROUGH_RMS[0] * 0.9 < grade.std() < drives.ROUGH_RMS[1] * 1.1
    power = np.abs(np.fft.rfft(grade)) ** 2
    wavelength_m = 1 / np.maximum(np.fft.rfftfreq(len(grade), np.diff(at_m)[0]), 1e-9)
    octaves = [power[(wavelength_m > a) & (wavelength_m <= 2 * a)].sum() for a in (50, 100, 200, 400, 800)]
    assert min(octaves) > 0.05 * power[1:].sum()


def test_who_looks_ahead_eases_off_before_the_crest(drives):
    family = outside(drives, "driver looks ahead*")
    before = simulate(scenario(replace(family, ahead=False))).history
    drive = scenario(family)["driver"]
    ahead_of = np.interp(before["distance_m"] + 250.0, before["distance_m"], before["grade"])
    change = np.interp(before["t_s"], drive["at_s"], drive["speed_mps"]) - before["speed_mps"]
    crest = (before["grade"] > 0.02) & (ahead_of < 0.0)
    assert crest.any()
    assert np.mean(change[crest] < 0.0) > 0.9


def test_all_four_are_all_four(drives):
    family = outside(drives, "all four*")
    found = scenario(family)
    assert (found["road"]["kind"], found["driver"]["kind"]) == ("points", "given")
    assert drawn(replace(family, ahead=False), "torque_gain", "gain").std() > 0.025
    assert drawn(replace(family, ahead=False), "torque_delay", "delay_s").max() > 0.2


def test_a_page_counts_what_misses_its_aim_and_makes_it_bold(calibration):
    figures = dict.fromkeys(calibration.FIGURES, 100.0)
    about = {"seed": 1, "estimator": "canest"}
    runs = [
        {"drive": drive, "accelerometer": accelerometer, **about, **figures, "in2": in2, "in3": in3}
        for drive, in2, in3 in (("pulses", 92.0, 90.0), ("all four*", 70.0, 94.9))
        for accelerometer in (False, True)
    ]
    inside, beyond = calibration.page(runs, "command").split("## Outside")
    for part, cell in ((inside, "**92.00** | 90.00"), (beyond, "70.00 | **94.90**")):
        assert "Of 4 such figures, totals apart, 2 miss it (bold)." in part
        assert part.count(cell) == 4
