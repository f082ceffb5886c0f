"""`benchmarks/sensitivity.py` and `ablation.py` change what they say, and only that."""

from __future__ import annotations

import numpy as np
import pytest

from canest.core import jit
from canest.estimators.default.constants import CONSTANTS

from .benchmark_modules import benchmark

variants = benchmark("variants")
sensitivity = benchmark("sensitivity")
ablation = benchmark("ablation")


@pytest.fixture
def short(variants, benchmark_module, monkeypatch):
    """Make a drive of 125 s known by the name of "short", estimated interpreted."""
    family = benchmark_module("calibration").Family("short", {"kind": "pulses"}, {}, 125, False)
    monkeypatch.setitem(variants.FAMILIES, "short", family)
    monkeypatch.setattr(jit, "enable", lambda: False)
    return "short"


def test_every_constant_is_halved_and_doubled(variants, sensitivity):
    names = variants.constant_names()
    assert len(names) == sum(len(group) for group in CONSTANTS)
    for name in names:
        for value in sensitivity.values_of(name).values():
            found = variants.changed(CONSTANTS, {name: value})
            differ = [
                (group, own)
                for group in CONSTANTS._fields
                for own, a, b in zip(
                    getattr(CONSTANTS, group)._fields,
                    getattr(CONSTANTS, group),
                    getattr(found, group),
                    strict=True,
                )
                if a != b or type(a) is not type(b)
            ]
            assert differ == [tuple(name.split("."))]


def test_a_probability_stays_below_1(sensitivity):
    for name in sensitivity.PROBABILITIES:
        assert 0.0 < max(sensitivity.values_of(name).values()) < 1.0
    assert sensitivity.values_of("load.banks") == {"halved": 2, "doubled": 8}


def test_one_constant_on_one_drive(variants, sensitivity, short):
    name = "noise.outlier"
    every = (variants.Variant(variants.DEFAULT), *sensitivity.variants_of([name]))
    runs = variants.one_drive((short, 1, every))
    assert len(runs) == 3 * 2
    found = sensitivity.effects(runs, [name])
    assert [row[0] for row in found] == [name]
    page = sensitivity.page(runs, found, "command")
    assert f"| `{name}` | 9 |" in page
    assert "    command -o docs/measured/sensitivity.md" in page


def test_a_signal_that_is_removed_counts_only_where_it_was(variants, ablation, short, monkeypatch):
    monkeypatch.setitem(ablation.SETS, "calibration", [short])
    chosen = [m for m in ablation.MECHANISMS if m.name in ("accelerometer", "altitude")]
    runs = variants.one_drive((short, 2, (variants.Variant(variants.DEFAULT), *chosen)))
    rms = {(run["variant"], run["accelerometer"]): run["grade_rms"] for run in runs}
    assert rms["accelerometer", False] == rms["default", False]
    assert rms["accelerometer", True] != rms["default", True]
    assert rms["altitude", False] != rms["default", False]
    page = ablation.page(runs, ablation.effects(runs, [m.name for m in chosen]), "command")
    assert "| **nothing** | | " in page


def test_without_any_mechanism_there_are_numbers_on_a_drive_with_stops(ablation, benchmark_module):
    judging = benchmark_module("judging")
    scenario = {
        "seed": 4,
        "duration_s": 60,
        "vehicle": "class8",
        "mass_kg": 2e4,
        "driver": {"kind": "stop-and-go", "drive_s": [12, 16], "stand_s": [6, 8]},
        "sensors": {"altitude_noise_m": 2.0},
    }
    drive = judging.prepare(scenario)
    assert np.any(np.diff(drive.samples.stopped.astype(int)) < 0)
    names = {mechanism.name for mechanism in ablation.MECHANISMS}
    assert len(names) == len(ablation.MECHANISMS)
    for mechanism in ablation.MECHANISMS:
        samples = mechanism.edit(drive.samples) if mechanism.edit else drive.samples
        edited = judging.Drive(samples, drive.facts, drive.mass_kg, drive.grade, drive.speed_mps)
        estimates, _ = judging.estimate_with(mechanism.make, edited, 21000.0, accelerometer=True)
        for column in (estimates.mass_kg, estimates.mass_std_kg, estimates.grade, estimates.grade_std):
            assert np.isfinite(column).all(), mechanism.name


def test_an_effect_is_the_mean_difference_and_the_share_of_runs_that_notice(variants):
    def run(rms, valid):
        return dict.fromkeys(variants.FIGURES, 0.0) | {"rms_120": rms, "valid": valid}

    found = variants.effect([run(1.0, 90.0), run(10.0, 90.0)], [run(1.01, 90.0), run(11.0, 86.0)])
    assert found.differences["rms_120"] == pytest.approx(0.505)
    assert found.differences["valid"] == pytest.approx(-2.0)
    assert (found.size, found.noticed) == (pytest.approx(2.0), 50.0)
    lost = variants.effect([run(1.0, 90.0)], [run(float("nan"), 90.0)])
    assert lost.noticed == 100.0
