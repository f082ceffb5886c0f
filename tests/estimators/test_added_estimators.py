"""Estimators of other packages: the example, and what happens when one is broken."""

from __future__ import annotations

import importlib
import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config
from canest.core.errors import ConfigError
from canest.core.plugins import load_plugins
from canest.core.samples import Status
from canest.estimators import registry
from canest.simulation.run import simulate
from tests.cli.conftest import canest  # noqa: F401 - a fixture

from .synthetic import FACTS, cut, drive, join

EXAMPLE = Path(__file__).parents[2] / "examples" / "canest-mean-mass"


def install(project: Path, site: Path) -> None:
    """Put a pure Python project where Python finds it, as pip does, but without pip, network or build."""
    about = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))
    name, version = about["project"]["name"], about["project"]["version"]
    for package in about["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        shutil.copytree(project / package, site / package)
    describe(site, name, version, about["project"]["entry-points"])


def describe(site: Path, name: str, version: str, entry_points: dict[str, dict[str, str]]) -> None:
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
        for group, entries in entry_points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(groups))


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder for packages that Python looks into during a test."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    load_plugins.cache_clear()
    yield folder
    for name in [n for n in sys.modules if n.startswith(("canest_mean_mass", "added_"))]:
        del sys.modules[name]
    importlib.invalidate_caches()
    load_plugins.cache_clear()


@pytest.fixture
def example(site):
    install(EXAMPLE, site)
    importlib.invalidate_caches()
    load_plugins.cache_clear()
    return site


@pytest.fixture(scope="module")
def level_drive(tmp_path_factory):
    scenario = {
        "seed": 3,
        "duration_s": 60,
        "vehicle": "class8",
        "mass_kg": 18_000,
        "road": {"kind": "flat"},
        "driver": {"kind": "pulses"},
        "bus": {"traffic": False},
    }
    folder = tmp_path_factory.mktemp("level")
    simulate(scenario).write(folder)
    return next(folder.glob("*.log")), next(folder.glob("*.truth.csv"))


def broken(site, name="added-broken", value="added_broken:Nothing", text="import no_such_package\n"):
    module = value.partition(":")[0]
    (site / f"{module}.py").write_text(text)
    describe(site, module, "1", {"canest.estimators": {name: value}})
    importlib.invalidate_caches()
    load_plugins.cache_clear()


def test_the_example_is_listed_and_shown(example, canest):  # noqa: F811
    listed = json.loads(canest("estimators", "list", "--json").out)
    assert [e["name"] for e in listed["estimators"]][-1] == "mean-mass"
    shown = json.loads(canest("estimators", "show", "mean-mass", "--json").out)
    assert [o["name"] for o in shown["options"]] == ["grade", "least_mps2"]
    assert shown["options"][1]["unit"] == "m/s²"


def test_the_example_replays_a_drive(example, canest, level_drive, tmp_path):  # noqa: F811
    log, _ = level_drive
    table = tmp_path / "est.csv"
    done = canest("replay", log, "-c", "class8", "--estimator", "mean-mass", "-o", table)
    assert done.code == 0, done.err
    last = table.read_text().splitlines()[-1].split(",")
    header = table.read_text().splitlines()[0].split(",")
    assert float(last[header.index("mass_kg")]) == pytest.approx(18_000.0, rel=0.1)


def test_the_example_stands_beside_the_others_in_compare(example, canest, level_drive, tmp_path):  # noqa: F811
    log, truth = level_drive
    table = tmp_path / "table.json"
    done = canest("compare", log, "-c", "class8", "--truth", truth, "--json", table, "--interpreted")
    assert done.code == 0, done.err
    rows = json.loads(table.read_text())["estimators"]
    assert list(rows) == [*registry.BUILT_IN, "mean-mass"]
    assert abs(rows["mean-mass"]["mass_end_pct"]) < 10.0


def test_the_example_gives_the_same_bits_for_any_cut(example):
    block = drive(40.0, noise_mps2=0.02, gaps=True).block
    options = {"least_mps2": 0.1}
    whole = join([registry.create("mean-mass", FACTS, options).update(block)])
    method = registry.create("mean-mass", FACTS, options)
    parts = join([method.update(part) for part in cut(block, [0, 1, 2, 700, 1999])])
    for name, column in whole.items():
        np.testing.assert_array_equal(parts[name], column, err_msg=name)
    assert whole["mass_kg"][-1] == pytest.approx(21_250.0, rel=0.05)
    assert whole["status"][-1] == Status.VALID


def test_its_wrong_option_is_named(example):
    with pytest.raises(ConfigError, match=r"estimator\.options\.grad: unknown option.*grade"):
        registry.create("mean-mass", FACTS, {"grad": 0.1})


@pytest.mark.parametrize(
    ("value", "text", "why"),
    [
        ("added_broken:Nothing", "import no_such_package\n", "cannot be imported: ModuleNotFoundError"),
        ("added_broken:Nothing", "Nothing = 1\n", "not a subclass of"),
        (
            "added_broken:Nothing",
            "from canest.estimators.base import Estimator\nclass Nothing(Estimator): pass\n",
            "does not define update",
        ),
        (
            "added_broken:Nothing",
            "from canest.estimators.base import Estimator\n"
            "class Nothing(Estimator):\n    def update(self, block): ...\n",
            "descriptions has no entry",
        ),
    ],
)
def test_a_broken_one_is_named_and_left_out(site, canest, value, text, why):  # noqa: F811
    broken(site, value=value, text=text)
    assert "added-broken" not in registry.names()
    assert why in registry.skipped()["added-broken"]
    listed = canest("estimators", "list")
    assert listed.code == 0
    assert "added-broken is left out" in listed.out
    assert why in json.loads(canest("estimators", "list", "--json").out)["skipped"]["added-broken"]


def test_a_built_in_name_stays_the_built_in_estimators(site):
    broken(site, name="rls", text="Nothing = 1\n")
    assert registry.describe("rls").source.startswith("2005")
    assert registry.skipped() == {"rls": "canest has an estimator of this name"}


def test_compare_says_which_one_it_left_out(site, canest, level_drive, tmp_path):  # noqa: F811
    log, truth = level_drive
    broken(site)
    table = tmp_path / "table.json"
    done = canest("compare", log, "-c", "class8", "--truth", truth, "--json", table, "--interpreted")
    assert done.code == 0, done.err
    found = json.loads(table.read_text())
    assert list(found["estimators"]) == list(registry.BUILT_IN)
    assert any("added-broken is left out" in note for note in found["notes"])


def test_a_config_is_refused_only_if_it_names_the_broken_one(site):
    broken(site)
    assert load_config("class8").estimator.name == "canest"
    with pytest.raises(ConfigError, match=r"cannot be used, found 'added-broken'.*no_such_package"):
        load_config("class8", ["estimator.name=added-broken"])


def test_known_names_do_not_read_the_packages_metadata():
    code = (
        "from canest.core.plugins import load_plugins\n"
        "from canest.config import load_config\n"
        "from canest.estimators import registry\n"
        "load_config('class8', ['estimator.name=rls'])\n"
        "registry.estimator_class('rls')\n"
        "print(load_plugins.cache_info().currsize)\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "0"
