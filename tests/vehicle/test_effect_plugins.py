"""Effects of other packages: what is taken, and what is skipped with a reason."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

import canest
from canest.config import parse_config
from canest.core.errors import ConfigError, PluginError
from canest.system.shipped_files import shipped
from canest.vehicle import effects
from canest.vehicle.effects import (
    EFFECTS,
    Effect,
    Parameter,
    all_effects,
    effect_class,
    effect_from_config,
    plugin_roles,
    skipped_effects,
)
from canest.vehicle.effects import registry as effect_registry
from tests.fresh_interpreter import output_of

CLASS8 = (shipped("configs") / "class8.yaml").read_text(encoding="utf-8")


@dataclass(frozen=True)
class PlowDrag(Effect):
    name: ClassVar[str] = "plow_drag"
    text: ClassVar[str] = "force of a snow plow while it is down"
    parameters: ClassVar[dict[str, Parameter]] = {"force_N": Parameter("N", 0.0, 0.0, 30e3, 100.0)}
    force_N: float = 0.0
    on_signal: str = "plow_down"

    @property
    def signal(self) -> str:
        return self.on_signal


class NoDataclass(Effect):
    name: ClassVar[str] = "no_dataclass"
    parameters: ClassVar[dict[str, Parameter]] = {"force_N": Parameter("N", 0.0, 0.0, 1.0, 0.1)}


@dataclass(frozen=True)
class NotNeutral(PlowDrag):
    name: ClassVar[str] = "not_neutral"
    force_N: float = 500.0


@dataclass(frozen=True)
class Sampling(PlowDrag):
    name: ClassVar[str] = "sampling"
    stage: ClassVar[Any] = "sampling"


@dataclass(frozen=True)
class NoDefaults(Effect):
    name: ClassVar[str] = "no_defaults"
    parameters: ClassVar[dict[str, Parameter]] = {"force_N": Parameter("N", 0.0, 0.0, 1.0, 0.1)}
    force_N: float


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, object]]:
    """Return what the entry points give, to be filled by a test."""
    loaded: dict[str, object] = {}
    skipped = {"broken_drag": "broken:Drag of broken cannot be imported: ImportError: no"}
    monkeypatch.setattr("canest.core.plugins.load_plugins", lambda _group: (loaded, skipped))
    effect_registry.plugin_effects.cache_clear()
    yield loaded
    effect_registry.plugin_effects.cache_clear()


def test_an_effect_of_another_package_is_one_like_ours(plugins: dict[str, object]) -> None:
    plugins["plow_drag"] = PlowDrag
    assert list(all_effects()) == [*EFFECTS, "plow_drag"]
    effect = effect_from_config({"effect": "plow_drag", "force_N": 2e3, "signal": "plow"})
    assert effect == PlowDrag(2e3, "plow") and effect.to_config()["signal"] == "plow"
    assert effect.describe(100.0) == "plow drag of 2e+03 ± 1e+02 N"
    with pytest.raises(ConfigError, match=r"plow_drag\.force_N, found -1, expected 0 to 30000 N"):
        effect_from_config({"effect": "plow_drag", "force_N": -1})


def test_a_config_may_name_the_role_that_drives_it(plugins: dict[str, object]) -> None:
    text = CLASS8.replace("signals:\n", "signals:\n  plow_down: {message: EEC1, signal: EngSpeed}\n")
    with pytest.raises(ConfigError, match="unknown role"):
        parse_config(text)
    plugins["plow_drag"] = PlowDrag
    effect_registry.plugin_effects.cache_clear()
    assert plugin_roles() == {"plow_down"}
    assert "plow_down" in parse_config(text).signals


@pytest.mark.parametrize(
    ("name", "given", "reason"),
    [
        ("force", lambda c: c, "is no subclass of canest.vehicle.effects.Effect"),
        ("headwind", EFFECTS["headwind"], "one of canest's own"),
        ("other_name", PlowDrag, "PlowDrag calls itself 'plow_drag'"),
        ("no_dataclass", NoDataclass, "has no field for each of its parameters"),
        ("not_neutral", NotNeutral, "NotNeutral.force_N is not neutral by default"),
        ("sampling", Sampling, "its stage is 'sampling', expected one of geometry"),
        ("no_defaults", NoDefaults, "NoDefaults() fails: TypeError"),
    ],
)
def test_what_is_no_effect_is_skipped_with_the_reason(
    plugins: dict[str, object], name: str, given: object, reason: str
) -> None:
    plugins[name] = given
    assert list(all_effects()) == list(EFFECTS)
    assert reason in skipped_effects()[name]
    assert effect_class("headwind") is EFFECTS["headwind"]


def test_a_config_that_uses_what_was_skipped_is_refused_with_the_reason(plugins: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"broken_drag cannot be used: .*ImportError: no"):
        parse_config(CLASS8 + "effects: [{effect: broken_drag}]\n")


def test_an_unknown_effect_names_the_nearest_of_all(plugins: dict[str, object]) -> None:
    plugins["plow_drag"] = PlowDrag
    with pytest.raises(ConfigError, match="found 'plow_drga', expected an effect, perhaps plow_drag"):
        effect_from_config({"effect": "plow_drga"})


def test_known_effects_read_no_metadata() -> None:
    """A scan of all installed packages would cost every start."""
    code = (
        "import sys\n"
        "from canest.config import load_config\n"
        "from canest.core.plugins import load_plugins\n"
        "load_config('class8', ['effects=[{effect: headwind, wind_mps: 1.0}]'])\n"
        "sys.exit(load_plugins.cache_info().misses)\n"
    )
    output_of(code)


def test_model_columns_under_their_old_name() -> None:
    with pytest.warns(DeprecationWarning, match="ModelColumns"):
        assert effects.Columns is effects.ModelColumns
    with pytest.raises(AttributeError, match="Colums"):
        _ = effects.Colums


@dataclass(frozen=True)
class Failing(PlowDrag):
    name: ClassVar[str] = "failing"

    def apply(self, c: Any) -> None:
        if self.force_N:
            raise KeyError("my own mistake")


@dataclass(frozen=True)
class Short(PlowDrag):
    name: ClassVar[str] = "failing"

    def apply(self, c: Any) -> None:
        c.extra_N = c.extra_N[:-1] - self.force_N


@dataclass(frozen=True)
class NoNumber(PlowDrag):
    name: ClassVar[str] = "failing"

    def apply(self, c: Any) -> None:
        c.extra_N = c.extra_N * math.nan


@pytest.mark.parametrize(
    ("kind", "message"),
    [(Short, r"its extra_N is wrong.*one number for each of"), (NoNumber, "its extra_N is wrong.*'NaN")],
)
def test_one_that_leaves_no_column_is_named(plugins: dict[str, object], kind: Any, message: str) -> None:
    """One that is too short ended a diagnosis, and NaN was listed there as a measured zero."""
    plugins["failing"] = kind
    drive = canest.demo_drive()
    signals = {**drive.config.signals, "plow_down": drive.config.signals["engine_speed"]}
    listed = {"effects": ({"effect": "failing", "force_N": 5.0},), "signals": signals}
    with pytest.raises(PluginError, match=rf"effect failing \(.*{message}"):
        canest.replay(drive, drive.config.model_copy(update=listed))
    found = canest.diagnose(drive, drive.config.model_copy(update={"signals": signals}), truth=drive.truth)
    assert "its extra_N is wrong" in found.document["not_tried"]["failing"]


def test_one_that_fails_is_named(plugins: dict[str, object]) -> None:
    plugins["failing"] = Failing
    drive = canest.demo_drive()
    config = drive.config.model_copy(update={"effects": ({"effect": "failing", "force_N": 5.0},)})
    with pytest.raises(
        PluginError, match=r"effect failing \(.*test_effect_plugins\): KeyError: 'my own mistake'"
    ):
        canest.replay(drive, config)


def test_one_that_fails_costs_a_diagnosis_nothing_else(plugins: dict[str, object]) -> None:
    drive = canest.demo_drive()
    signals = {**drive.config.signals, "plow_down": drive.config.signals["engine_speed"]}
    config = drive.config.model_copy(update={"signals": signals})
    plugins["failing"] = Failing
    found = canest.diagnose(drive, config, truth=drive.truth)
    assert "my own mistake" in found.document["not_tried"]["failing"]
    assert len(found.document["candidates"]) > 5


@pytest.mark.parametrize(
    "entries",
    [
        "[{effect: drag_area, cda_delta_m2: -2.5}, {effect: drag_area, cda_delta_m2: -2.5}, "
        "{effect: drag_area, cda_delta_m2: -2.5}]",
        "[{effect: rolling_resistance, crr_delta: -0.02}]",
    ],
)
def test_what_the_vehicle_declares_and_effects_are_never_negative(entries: str) -> None:
    with pytest.raises(ConfigError, match=r"and this are negative, .*expected a sum of 0 or more"):
        parse_config(CLASS8 + f"effects: {entries}\n")
