"""Scenario files: reading, and for each mistake its place, what is wrong and what was expected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from canest.config.limits import mistake_in_yaml, read_text, refuse_excess
from canest.config.origins import KeyPath, lines_of
from canest.core.errors import ConfigError
from canest.core.validation import first_mistake
from canest.simulation.scenario import Scenario

SCENARIOS = Path(__file__).resolve().parent / "scenarios"


def shipped_scenarios() -> list[str]:
    """Return the names of the scenarios that ship."""
    return sorted(path.stem for path in SCENARIOS.glob("*.yaml"))


def scenario_file(name: str | Path) -> Path:
    """Return the file of a scenario, given by its path or a shipped name. Errors: ConfigError."""
    path = Path(name)
    if not path.is_file():
        path = SCENARIOS / f"{name}.yaml"
    if not path.is_file():
        expected = f"a file or one of {', '.join(shipped_scenarios())}"
        raise ConfigError("no such scenario", where=str(name), expected=expected)
    return path


def name_of(scenario: str | Path) -> str:
    """Return the name that the files of a drive get; a shipped name may have a dot in it."""
    return Path(str(scenario)).name.removesuffix(".yaml").removesuffix(".yml")


def load_scenario(source: Scenario | dict[str, Any] | str | Path) -> Scenario:
    """Return the scenario of a file, a shipped name, a mapping, or as given.

    Errors: ConfigError with file, line and key of the first thing wrong.
    """
    if isinstance(source, Scenario):
        return source
    if isinstance(source, dict):
        return _validated(source, "scenario", {})
    path = scenario_file(source)
    try:
        text = read_text(path)
        refuse_excess(text, str(path))
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        problem, line = mistake_in_yaml(error, text)
        raise ConfigError(f"not readable as YAML ({problem})", where=f"{path}{line}") from None
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError("not a scenario", where=str(path), expected="a mapping of keys")
    return _validated(data, str(path), lines_of(node, str(path)))


def _validated(data: Any, where: str, lines: dict[KeyPath, int]) -> Scenario:
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise _explained(error, where, lines) from None


def _explained(error: ValidationError, where: str, lines: dict[KeyPath, int]) -> ConfigError:
    mistake = first_mistake(error)
    name, line = mistake.key, _line(mistake.path, lines)
    place = f"{where}:{line}" if line else where
    match mistake.kind:
        case "unknown key":  # a misspelt key is also a missing one
            return ConfigError(f"{name}: unknown key", where=place, expected=" and ".join(mistake.siblings))
        case "missing":
            return ConfigError(f"{name}: is missing", where=place)
        case "contradiction":
            return ConfigError(f"{name}: {mistake.words}", where=place)
    return ConfigError(name, where=place, found=mistake.found, expected=mistake.words)


def _line(key: KeyPath, lines: dict[KeyPath, int]) -> int | None:
    """Return the line of a key, or of the nearest one above it."""
    # the tag of a union stands in pydantic's location but not in the file
    for path in [key] + [key[:i] + key[i + 1 :] for i in range(len(key))]:
        if path in lines:
            return lines[path]
    return _line(key[:-1], lines) if key else None
