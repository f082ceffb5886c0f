"""Reads a YAML config and turns every mistake into one line: file, line, key, found, expected."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from canest.config.schema import Config
from canest.errors import ConfigError
from canest.resources import find

#: libyaml's safe loader where PyYAML was built with it (ten times faster), else the one in Python
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def load_config(name: str | Path, overrides: Iterable[str] = ()) -> Config:
    """Load a config by path or shipped name, with ``dotted.key=value`` overrides (values are YAML).

    Errors: ConfigError naming file, line and key of the first mistake, and how many more there are.
    """
    path = find("configs", str(name))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read ({error})", where=str(path)) from error
    return parse_config(text, str(path), overrides)


def parse_config(text: str, where: str = "config", overrides: Iterable[str] = ()) -> Config:
    """Validate YAML text; ``where`` names it in errors. Errors: ConfigError."""
    try:
        node = yaml.compose(text, Loader=_LOADER)
        raw = yaml.load(text, Loader=_LOADER)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise ConfigError(
            f"not valid YAML ({getattr(error, 'problem', error)})", where=where + line
        ) from error
    except ValueError as error:  # e.g. an impossible date
        raise ConfigError(f"not valid YAML ({error})", where=where) from error
    if not isinstance(raw, dict):
        raise ConfigError(
            "is not a mapping of sections",
            where=where,
            found=type(raw).__name__,
            expected="vehicle:, signals: and so on",
        )
    duplicate = _duplicate_key(node)
    if duplicate:
        raise ConfigError(f"key given twice: {duplicate[0]}", where=f"{where}:{duplicate[1]}")
    changed = _apply_overrides(raw, overrides)
    try:
        return Config.model_validate(raw)
    except ValidationError as error:
        raise _explain(error, node, where, changed) from error


def _apply_overrides(raw: dict[str, Any], overrides: Iterable[str]) -> set[str]:
    changed = set()
    for override in overrides:
        key, equals, value = override.partition("=")
        if not equals or not key:
            raise ConfigError("malformed --set", found=override, expected="dotted.key=value")
        target = raw
        *parents, last = key.strip().split(".")
        for part in parents:
            child = target.setdefault(part, {})
            if not isinstance(child, dict):
                raise ConfigError(f"--set {key}: {part} is not a section")
            target = child
        try:
            target[last] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise ConfigError(f"--set {key}: not a YAML value", found=value) from error
        changed.add(key.strip())
    return changed


def _explain(error: ValidationError, node: yaml.Node | None, where: str, changed: set[str]) -> ConfigError:
    problems = error.errors(include_url=False)
    first = problems[0]
    path = [str(p) for p in first["loc"]]
    key = ".".join(path) or "(whole config)"
    overridden = any(change == key or change.startswith(f"{key}.") for change in changed)
    origin = "--set" if overridden else f"{where}:{_line_of(node, path)}"
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "missing":
        return ConfigError(f"{key}: is missing", where=origin, expected="a value" + _more(problems))
    if first["type"] == "extra_forbidden":
        return ConfigError(f"{key}: unknown key", where=origin, expected=_known_keys(path) + _more(problems))
    found = first.get("input")
    shown = found if isinstance(found, str | int | float | bool) or found is None else type(found).__name__
    if first["type"] == "value_error":
        return ConfigError(f"{key}: {message}{_more(problems)}", where=origin)
    return ConfigError(key, where=origin, found=shown, expected=_plain(message) + _more(problems))


def _plain(message: str) -> str:
    return message.removeprefix("Input should be ").replace("a valid ", "a ")


def _more(problems: list[Any]) -> str:
    return f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""


def _known_keys(path: list[str]) -> str:
    model: Any = Config
    for part in path[:-1]:
        field = model.model_fields.get(part) if hasattr(model, "model_fields") else None
        if field is None:
            return "one of the documented keys"
        model = field.annotation
    names = getattr(model, "model_fields", None)
    return "one of " + ", ".join(names) if names else "one of the documented keys"


def _line_of(node: yaml.Node | None, path: list[str]) -> int:
    """Return the line of the deepest part of ``path`` that the YAML text has (1 when it has none)."""
    line = 1
    for part in path:
        if isinstance(node, yaml.MappingNode):
            pairs = {key.value: (key, value) for key, value in node.value}
            if part not in pairs:
                return line
            key, node = pairs[part]
            line = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode) and part.isdigit() and int(part) < len(node.value):
            node = node.value[int(part)]
            line = node.start_mark.line + 1
        else:
            return line
    return line


def _duplicate_key(node: yaml.Node | None) -> tuple[str, int] | None:
    """Return the first key that a mapping has twice, with its line (YAML itself would keep the last)."""
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            if key.value in seen:
                return str(key.value), key.start_mark.line + 1
            seen.add(key.value)
            deeper = _duplicate_key(value)
            if deeper:
                return deeper
    elif isinstance(node, yaml.SequenceNode):
        for item in node.value:
            deeper = _duplicate_key(item)
            if deeper:
                return deeper
    return None
