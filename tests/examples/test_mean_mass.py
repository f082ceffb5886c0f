"""The example estimator as a user meets it: installed, shown, replayed, and compared with the others."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from example_helpers import ROOT, install

from canest.core.errors import ConfigError
from canest.core.plugins import load_plugins
from canest.core.samples import Status
from canest.estimators import registry
from canest.simulation.run import simulate
from tests.estimators.synthetic import FACTS, cut, drive, join

EXAMPLE = ROOT / "examples" / "canest-mean-mass"
MASS_KG = 18_000.0


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("site")
    install(EXAMPLE, target)
    return target


@pytest.fixture(scope="module")
def level_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scenario = {
        "seed": 3,
        "duration_s": 60,
        "vehicle": "class8",
        "mass_kg": MASS_KG,
        "road": {"kind": "flat"},
        "driver": {"kind": "pulses"},
        "bus": {"traffic": False},
    }
    folder = tmp_path_factory.mktemp("level")
    simulate(scenario).write(folder)
    return next(folder.glob("*.log"))


@pytest.fixture
def importable(installed, monkeypatch):
    """Make the example a part of this process for one test."""
    monkeypatch.syspath_prepend(installed)
    importlib.invalidate_caches()
    load_plugins.cache_clear()
    yield
    sys.modules.pop("canest_mean_mass", None)
    load_plugins.cache_clear()


def test_it_is_listed_and_shown(canest_with, installed):
    listed = json.loads(canest_with(installed, "estimators", "list", "--json").stdout)
    assert [e["name"] for e in listed["estimators"]] == [*registry.BUILT_IN, "mean-mass"]
    shown = json.loads(canest_with(installed, "estimators", "show", "mean-mass", "--json").stdout)
    assert [(o["name"], o["unit"]) for o in shown["options"]] == [("grade", "ratio"), ("least_mps2", "m/s²")]


def test_it_replays_a_drive(canest_with, installed, level_drive, tmp_path):
    table = tmp_path / "est.csv"
    done = canest_with(
        installed, "replay", level_drive, "-c", "class8", "--estimator", "mean-mass", "-o", table
    )
    assert done.returncode == 0, done.stderr
    header, *rows = table.read_text().splitlines()
    last = dict(zip(header.split(","), rows[-1].split(","), strict=True))
    assert float(last["mass_kg"]) == pytest.approx(MASS_KG, rel=0.1)


def test_it_stands_beside_the_others_in_compare(canest_with, installed, level_drive, tmp_path):
    table = tmp_path / "table.json"
    done = canest_with(
        installed, "compare", level_drive, "-c", "class8", "--truth", "auto", "--json", table, "--interpreted"
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads(table.read_text())["estimators"]
    assert list(rows) == [*registry.BUILT_IN, "mean-mass"]
    assert abs(rows["mean-mass"]["mass_end_pct"]) < 10.0


def test_without_the_package_its_name_is_unknown(canest_with, tmp_path, level_drive):
    done = canest_with(tmp_path, "replay", level_drive, "-c", "class8", "--estimator", "mean-mass")
    assert done.returncode == 2
    assert "unknown estimator, found 'mean-mass'" in done.stderr


def test_any_cut_gives_the_same_bits(importable):
    block, options = drive(40.0, noise_mps2=0.02, gaps=True).block, {"least_mps2": 0.1}
    whole = join([registry.create("mean-mass", FACTS, options).update(block)])
    method = registry.create("mean-mass", FACTS, options)
    parts = join([method.update(part) for part in cut(block, [0, 1, 2, 700, 1999])])
    for name, column in whole.items():
        np.testing.assert_array_equal(parts[name], column, err_msg=name)
    assert whole["mass_kg"][-1] == pytest.approx(21_250.0, rel=0.05)
    assert whole["status"][-1] == Status.VALID


def test_its_wrong_option_is_named(importable):
    with pytest.raises(ConfigError, match=r"estimator\.options\.grad: unknown option.*grade"):
        registry.create("mean-mass", FACTS, {"grad": 0.1})
