"""Estimators of other packages: one that fails, or returns nonsense, is named and harms nobody else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import canest
from canest.core.errors import ConfigError, PluginError
from canest.core.samples import EstimateBlock, VehicleFacts
from canest.estimators import registry
from canest.estimators.base import Estimator
from canest.estimators.contract import updated
from canest.estimators.description import Description, option
from canest.estimators.options import Options
from canest.logs.memory import FrameLog
from canest.offline.compare import compare
from canest.offline.scoring import Reference
from tests.estimators.synthetic import drive

FACTS = VehicleFacts(mass_min_kg=5_000.0, mass_max_kg=44_000.0, rolling_resistance=0.006)


class MineOptions(Options):
    grade: float = option(0.0, "grade of the whole road", unit="ratio", ge=-0.3, le=0.3)


class Mine(Estimator):
    descriptions = (Description("mine", "a constant", "this file", options=MineOptions),)

    def update(self, block):
        n = len(block)
        return EstimateBlock(np.full(n, 2e4), np.full(n, 1e3), np.zeros(n), np.ones(n), np.ones(n, np.uint8))


def returning(**changes):
    """An estimator that returns other columns."""

    class Changed(Mine):
        def update(self, block):
            return replace(super().update(block), **{k: make(len(block)) for k, make in changes.items()})

    return Changed


class Fails(Mine):
    def update(self, block):
        raise ZeroDivisionError("my own mistake")


class Writes(Mine):
    def update(self, block):
        block.force_N[:] = 0.0
        return super().update(block)


class ReturnsNone(Mine):
    def update(self, block):
        return None


@pytest.fixture(scope="module")
def block():
    return drive(5.0).block


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Fails, "estimator mine .*ZeroDivisionError: my own mistake"),
        (Writes, "read-only"),
        (ReturnsNone, "returns no estimates, found 'NoneType'"),
        (returning(mass_kg=lambda n: np.full(n, np.inf)), "mass_kg is impossible, found 'inf'"),
        (returning(mass_kg=lambda n: np.full(n, 99e3)), "mass_kg is impossible, found '99000'"),
        (returning(mass_std_kg=lambda n: np.full(n, -1.0)), "mass_std_kg is impossible"),
        (returning(status=lambda n: np.full(n, 7, np.uint8)), "status is impossible"),
        (returning(grade=lambda n: np.zeros(n - 1)), "its grade is wrong"),
        (returning(grade=lambda n: ["?"] * n), "its grade is wrong"),
        (
            returning(mass_kg=lambda n: np.full(n, np.nan), status=lambda n: np.full(n, 2, np.uint8)),
            "its status is wrong, found 'VALID without a mass'",
        ),
    ],
)
def test_what_breaks_the_contract_is_one_error_with_its_name(block, kind, message):
    with pytest.raises(PluginError, match=message):
        updated(kind("mine", FACTS), block)
    assert block.force_N.flags.writeable and np.any(block.force_N)


def test_lists_and_missing_numbers_are_taken(block):
    kind = returning(mass_kg=lambda n: [2e4] * n, grade=lambda n: np.full(n, np.nan))
    found = updated(kind("mine", FACTS), block)
    assert found.mass_kg.dtype == np.float64 and np.isnan(found.grade).all()


def test_options_are_checked_without_a_constructor():
    assert Mine("mine", FACTS, {"grade": 0.1}).options.grade == 0.1
    for options in ({"grad": 0.1}, {"grade": 5}):
        with pytest.raises(ConfigError, match=r"estimator\.options"):
            Mine("mine", FACTS, options)


@pytest.mark.parametrize("kind", [Fails, Writes])
def test_one_that_fails_costs_the_others_nothing(monkeypatch, kind):
    drive = canest.demo_drive()
    log = FrameLog(drive.frames[: len(drive.frames) // 4])

    def table(*names):
        reference = Reference(mass_kg=21e3)
        return compare(drive.config, log, reference=reference, names=names, compiled=False).table

    alone = table("rls")["estimators"]["rls"]
    monkeypatch.setitem(registry.BUILT_IN, "mine", f"{__name__}:{kind.__name__}")
    both = table("mine", "rls")["estimators"]
    assert both["mine"]["mass_end_pct"] is None and "estimator mine" in both["mine"]["note"]
    assert both["rls"]["mass_end_pct"] == alone["mass_end_pct"] is not None


class NeedsAFile(Mine):
    def __init__(self, name, facts, options=None):
        raise FileNotFoundError("no calibration file")


class ForgetsItsBase(Mine):
    def __init__(self, name, facts, options=None):
        self.mass_kg = 0.0


@pytest.mark.parametrize(
    ("kind", "message"),
    [(NeedsAFile, "FileNotFoundError: no calibration file"), (ForgetsItsBase, "super.*__init__")],
)
def test_one_that_cannot_be_made_is_named_and_left_out_of_all(monkeypatch, kind, message):
    """It ended every comparison with an unexpected error that named nobody."""
    monkeypatch.setitem(registry.BUILT_IN, "mine", f"{__name__}:{kind.__name__}")
    with pytest.raises(PluginError, match=f"estimator mine .*{message}"):
        registry.create("mine", FACTS)
    drive = canest.demo_drive()
    log = FrameLog(drive.frames[: len(drive.frames) // 8])
    with pytest.raises(PluginError, match="estimator mine"):
        compare(drive.config, log, reference=Reference(mass_kg=21e3), names=["mine"], compiled=False)
    monkeypatch.setattr(registry, "names", lambda: ["mine", "rls"])
    table = compare(drive.config, log, reference=Reference(mass_kg=21e3), compiled=False).table
    assert list(table["estimators"]) == ["rls"]
    assert any("estimator mine is left out: " in note for note in table["notes"])


def test_the_loss_of_a_mass_beyond_its_bound_is_that_of_the_bound():
    """60 t on 1 % of grade, and a bound of 40 t: the residuals that stay widen the grade, too."""
    heavy = drive(60.0, mass_kg=60_000.0, grade=0.01, noise_mps2=0.02)
    e = registry.create("batch-ls", replace(FACTS, mass_max_kg=40_000.0)).update(heavy.block)
    assert e.mass_kg[-1] == pytest.approx(40_000.0)
    assert e.grade_std[-1] > 1e-4
