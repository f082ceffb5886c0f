"""The configs that ship load, and everything they name exists."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from canest.config import load_config
from canest.config.schema import Config
from canest.core.errors import ConfigError
from canest.pipeline.pipeline import Pipeline
from canest.system.shipped_files import shipped

NAMES = sorted(p.stem for p in shipped("configs").glob("*.yaml"))


def test_the_documented_ones_are_there() -> None:
    assert {"class8", "class8-j1587", "kenworth", "bmw-i3", "ztbus", "obd-car", "vcan"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_it_loads_and_resolves(name: str) -> None:
    config = load_config(name)
    pipeline = Pipeline(config)
    from_frames = [s for s in config.signals.values() if s.message is not None]
    assert bool(pipeline.decoder.can_filters()) == bool(from_frames)
    assert load_config(f"{name}.yaml") == config


@pytest.mark.parametrize("name", NAMES)
def test_it_survives_being_written_out(name: str) -> None:
    config = load_config(name)
    assert Config.model_validate(config.model_dump()) == config


def test_nothing_in_a_config_can_be_changed_afterwards() -> None:
    config = load_config("class8")
    with pytest.raises(ValueError, match="frozen"):
        config.vehicle.mass_min_kg = 1.0  # type: ignore[misc]


def test_a_config_in_a_folder_that_may_not_be_entered_is_not_called_missing(monkeypatch) -> None:
    known = Path.stat

    def stat(path: Path, **how: bool) -> os.stat_result:
        if path.parts[0] == "private":
            raise PermissionError(13, "Permission denied", str(path))
        return known(path, **how)

    monkeypatch.setattr(Path, "stat", stat)
    with pytest.raises(ConfigError, match="may not be entered"):
        load_config("private/my-truck.yaml")
