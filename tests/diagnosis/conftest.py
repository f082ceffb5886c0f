"""Simulated drives with effects that their configs do not declare; each is made and diagnosed once."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from canest.cli import progress
from canest.cli.main import run
from canest.simulation import simulate

SCENARIO: dict[str, Any] = {
    "duration_s": 240,
    "vehicle": "class8",
    "mass_kg": 21250,
    "road": {"kind": "highway"},
    "driver": {"kind": "pulses"},
    "bus": {"traffic": False},
}


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Let no slow machine add lines of progress to what is printed."""
    monkeypatch.setattr(progress, "LINE_PATIENCE_S", 3600.0)


@pytest.fixture(scope="session")
def drive(tmp_path_factory):
    """Return a maker of logs: `drive(effect..., seed=1)` gives NAME.log, truth and config beside it."""
    folder = tmp_path_factory.mktemp("drives")

    @cache
    def make(undeclared: str = "[]", seed: int = 1, changes: str = "{}") -> Path:
        made = simulate(SCENARIO | {"undeclared": json.loads(undeclared)} | json.loads(changes), seed)
        place = folder / f"drive{len(list(folder.iterdir()))}"
        place.mkdir()
        return next(p for p in made.write(place) if p.suffix == ".log")

    return lambda *undeclared, seed=1, **changes: make(json.dumps(undeclared), seed, json.dumps(changes))


@pytest.fixture(scope="session")
def diagnosed(tmp_path_factory):
    """Return a runner of `canest diagnose LOG... -c CONFIG ARGUMENTS` that gives the directory it wrote."""

    @cache
    def diagnose(*arguments: str) -> Path:
        out = tmp_path_factory.mktemp("out")
        logs = [a for a in arguments if a.endswith(".log")]
        config = Path(logs[0]).with_suffix(".yaml")
        assert run(["diagnose", *arguments, "-c", str(config), "-o", str(out)]) == 0
        return out

    return lambda *arguments: diagnose(*map(str, arguments))


@pytest.fixture(scope="session")
def found(diagnosed):
    """Return a runner that gives what diagnosis.json says."""
    return lambda *arguments: json.loads((diagnosed(*arguments) / "diagnosis.json").read_text("utf-8"))
