"""`benchmarks/sensitivity.py` and `ablation.py` change what they say, and only that."""

from __future__ import annotations

import pkgutil
from dataclasses import fields

import numpy as np
import pytest

from canest.core import jit
from canest.core.samples import VehicleFacts
from canest.estimators.default.constants import CONSTANTS

from .benchmark_modules import benchmark

variants = benchmark("variants")
sensitivity = benchmark("sensitivity")
ablation = benchmark("ablation")
patching = benchmark("patched")


@pytest.fixture
def short(variants, benchmark_module, monkeypatch):
    """Make a drive of 125 s known by the name of "short", estimated interpreted."""
    family = benchmark_module("calibration").Family("short", {"kind": "pulses"}, {}, 125, False)
    monkeypatch.setitem(variants.FAMILIES, "short", family)
    monkeypatch.setattr(jit, "enable", lambda: False)
    return "short"


def test_every_constant_is_halved_and_doubled(variants, sensitivity):
    assert len(sensitivity.VALUES) == len(CONSTANTS)
    for name, value in sensitivity.VALUES.items():
        halved, doubled = sensitivity.values_of(name).values()
        assert halved == value / 2.0
        assert value < doubled <= 2.0 * value
        found = variants.changed(CONSTANTS, {name: doubled})
        differ = [a for a, b, c in zip(CONSTANTS._fields, CONSTANTS, found, strict=True) if b != c]
        assert differ == [name]


def test_what_cannot_be_more_than_1_stays_below(sensitivity):
    for name in sensitivity.PROBABILITIES:
        assert 0.0 < max(sensitivity.values_of(name).values()) < 1.0
    for name in sensitivity.WHOLE:
        assert max(sensitivity.values_of(name).values()) <= 1.0


def test_one_constant_on_one_drive(variants, sensitivity, short):
    name = "outlier_nis"
    every = (variants.Variant(variants.DEFAULT), *sensitivity.variants_of([name]))
    runs = variants.one_drive((short, 1, every))
    assert len(runs) == 3 * 2
    found = sensitivity.effects(runs, [name])
    assert [row[0] for row in found] == [name]
    page = sensitivity.page(runs, found, "command")
    assert f"| `{name}` | 9 |" in page
    assert "    command -o docs/measured/sensitivity.md" in page


def test_every_mechanism_changes_names_that_there_are(ablation, patching):
    names = [mechanism.name for mechanism in ablation.MECHANISMS]
    assert len(set(names)) == len(names)
    for mechanism in ablation.MECHANISMS:
        assert set(mechanism.values) <= set(CONSTANTS._fields), mechanism.name
        assert set(mechanism.facts) <= {field.name for field in fields(VehicleFacts)}, mechanism.name
        assert mechanism.values or mechanism.facts or mechanism.patch or mechanism.edit, mechanism.name
        with patching.patched(mechanism.patch):
            for name, value in mechanism.patch.items():
                found = pkgutil.resolve_name(f"{patching.PACKAGE}.{name}")
                assert found == value or found.interpreted.__name__ == value.__name__, mechanism.name


def test_a_patch_holds_within_and_not_after(variants, patching, short):
    drive = variants.draw(short, 3)
    whole, other = variants.Variant("whole"), variants.Variant("patched", patch={"noise._STEP_STD": 1e9})
    ends = []
    for one in (whole, other, whole):
        with patching.patched(one.patch):
            estimates, _ = variants.estimate_with(one.make, drive, 21000.0, accelerometer=True)
        ends.append(float(estimates.grade[-1]))
    assert ends[0] == ends[2] != ends[1]
    with pytest.raises(AttributeError), patching.patched({"kernel._NO_SUCH_NAME": 0}):
        pass


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


def test_without_any_mechanism_there_are_numbers_on_a_drive_with_stops(ablation, patching, benchmark_module):
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
    for mechanism in ablation.MECHANISMS:
        samples = mechanism.edit(drive.samples) if mechanism.edit else drive.samples
        edited = judging.Drive(samples, drive.facts, drive.mass_kg, drive.grade, drive.speed_mps)
        with patching.patched(mechanism.patch):
            estimates, _ = judging.estimate_with(mechanism.make, edited, 21000.0, accelerometer=True)
        for column in (estimates.mass_kg, estimates.mass_std_kg, estimates.grade, estimates.grade_std):
            assert np.isfinite(column).all(), mechanism.name


def test_an_effect_is_the_mean_difference_and_the_share_of_runs_that_notice(variants):
    def run(seed, rms, valid):
        about = {"drive": "any", "seed": seed}
        return about | dict.fromkeys(variants.FIGURES, 0.0) | {"rms_120": rms, "valid": valid}

    before = [run(1, 1.0, 90.0), run(2, 10.0, 90.0)]
    found = variants.effect(before, [run(1, 1.01, 90.0), run(2, 11.0, 86.0)])
    assert found.differences["rms_120"] == pytest.approx(0.505)
    assert found.differences["valid"] == pytest.approx(-2.0)
    assert (found.size, found.noticed) == (pytest.approx(2.0), 50.0)
    assert found.errors["valid"] == pytest.approx(2.0)  # of two drives
    assert not found.is_certain("valid")
    lost = variants.effect(before[:1], [run(1, float("nan"), 90.0)])
    assert lost.noticed == 100.0
