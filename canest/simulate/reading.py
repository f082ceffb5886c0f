"""Reads scenarios, and says of every mistake where it stands, what it is and what was expected."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from canest.config.origins import KeyPath, lines_of
from canest.core.errors import ConfigError
from canest.simulate.scenario import Scenario

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
        text = path.read_text(encoding="utf-8")
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, OSError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        raise ConfigError(f"not readable as YAML ({getattr(error, 'problem', error)})", where=place) from None
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError("not a scenario", where=str(path), expected="a mapping of keys")
    return _validated(data, str(path), lines_of(node, str(path)))


def _validated(data: Any, where: str, lines: dict[KeyPath, int]) -> Scenario:
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise _explained(error.errors(include_url=False), where, lines) from None


def _explained(problems: list[Any], where: str, lines: dict[KeyPath, int]) -> ConfigError:
    # a misspelt key is also a missing one: the misspelling says more
    first = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    at = first["loc"]
    name, message = ".".join(map(str, at)), first["msg"].removeprefix("Value error, ")
    line = _line(tuple(map(str, at)), lines)
    place = f"{where}:{line}" if line else where
    match first["type"]:
        case "extra_forbidden":
            missing = [
                str(p["loc"][-1]) for p in problems if p["type"] == "missing" and p["loc"][:-1] == at[:-1]
            ]
            return ConfigError(f"{name}: unknown key", where=place, expected=" and ".join(missing))
        case "missing":
            return ConfigError(f"{name}: is missing", where=place)
        case "value_error":
            return ConfigError(f"{name}: {message}", where=place)
        case "union_tag_invalid":
            found, expected = first["ctx"]["tag"], first["ctx"]["expected_tags"]
        case _:
            found, expected = _short(first["input"]), message.removeprefix("Input should be ")
    return ConfigError(name, where=place, found=found, expected=expected)


def _line(key: KeyPath, lines: dict[KeyPath, int]) -> int | None:
    """Return the line of a key, or of the nearest one above it."""
    # the tag of a union stands in pydantic's location but not in the file
    for path in [key] + [key[:i] + key[i + 1 :] for i in range(len(key))]:
        if path in lines:
            return lines[path]
    return _line(key[:-1], lines) if key else None


def _short(value: object) -> object:
    text = repr(value)
    return value if len(text) < 60 else text[:57] + "..."
