"""Estimators of other packages that cannot be used, and when other packages are looked at at all."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys

import pytest

from canest.config import load_config
from canest.core.errors import ConfigError
from canest.core.plugins import load_plugins
from canest.core.samples import STEP_US
from canest.estimators import registry
from canest.offline.compare import compare
from canest.offline.scoring import Reference
from tests.cli.conftest import canest  # noqa: F401 - a fixture

ESTIMATOR = "from canest.estimators.base import Estimator\nclass Nothing(Estimator):\n    "


@pytest.fixture
def add(tmp_path, monkeypatch):
    """Return a function that installs a package whose one module has a given text."""
    monkeypatch.syspath_prepend(tmp_path)

    def install(name: str = "added", text: str = "import no_such_package\n") -> None:
        (tmp_path / "added_module.py").write_text(text)
        info = tmp_path / "added_module-1.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: added-module\nVersion: 1\n")
        (info / "entry_points.txt").write_text(f"[canest.estimators]\n{name} = added_module:Nothing\n")
        importlib.invalidate_caches()
        load_plugins.cache_clear()

    yield install
    sys.modules.pop("added_module", None)
    load_plugins.cache_clear()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import no_such_package\n", "cannot be imported: ModuleNotFoundError"),
        ("Nothing = 1\n", "not a subclass of"),
        (ESTIMATOR + "pass\n", "does not define update"),
        (ESTIMATOR + "def update(self, block): ...\n", "descriptions has no entry"),
    ],
)
def test_a_broken_one_is_named_and_left_out(add, canest, text, why):  # noqa: F811
    add(text=text)
    assert "added" not in registry.names()
    assert why in registry.skipped()["added"]
    listed = canest("estimators", "list")
    assert listed.code == 0
    assert "added is left out" in listed.out
    assert why in json.loads(canest("estimators", "list", "--json").out)["skipped"]["added"]


def test_a_name_of_canest_stays_canests_own(add):
    add(name="rls", text="Nothing = 1\n")
    assert registry.describe("rls").source.startswith("2005")
    assert registry.skipped() == {"rls": "canest has an estimator of this name"}


def test_compare_names_the_one_it_left_out(add, tmp_path):
    log = tmp_path / "drive.csv"
    rows = "".join(f"{k * STEP_US / 1e6:.2f},10,500,1\n" for k in range(100))
    log.write_text("t_s,v_mps,torque_Nm,gear\n" + rows)
    config = load_config("testcar")
    signals = {
        "vehicle_speed": {"column": "v_mps", "unit": "m/s"},
        "gear": {"column": "gear"},
        "engine_torque": {"column": "torque_Nm", "unit": "Nm"},
    }
    add()
    config = type(config).model_validate({**config.model_dump(), "signals": signals})
    table = compare(config, log, reference=Reference(mass_kg=1500.0), compiled=False).table
    assert list(table["estimators"]) == list(registry.BUILT_IN)
    assert any("added is left out" in note for note in table["notes"])


def test_a_config_is_refused_only_if_it_names_the_broken_one(add):
    add()
    assert load_config("class8").estimator.name == "canest"
    with pytest.raises(ConfigError, match=r"cannot be used, found 'added'.*no_such_package"):
        load_config("class8", ["estimator.name=added"])


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
