"""Reads a YAML config and turns every mistake into one line: file, line, key, found, expected."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import ValidationError

from canest.config.schema import Config, MisplacedError
from canest.errors import ConfigError
from canest.resources import find, is_file

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
    config = parse_config(text, str(path), overrides)
    local = _beside(path, config.dbc)
    return config if local == config.dbc else config.model_copy(update={"dbc": local})


def _beside(config: Path, names: Iterable[str]) -> tuple[str, ...]:
    """Return the DBC names, those of files beside the config as paths that hold in any directory."""
    files = ((name, config.parent / name) for name in names)
    return tuple(str(file.resolve()) if is_file(file) else name for name, file in files)


def parse_config(text: str, where: str = "config", overrides: Iterable[str] = ()) -> Config:
    """Validate YAML text; ``where`` names it in errors. Errors: ConfigError."""
    try:
        node = yaml.compose(text, Loader=_LOADER)
        raw = yaml.load(text, Loader=_LOADER)
        duplicate = _duplicate_key(node, set()) if isinstance(raw, dict) else None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise ConfigError(
            f"not valid YAML ({getattr(error, 'problem', error)})", where=where + line
        ) from error
    except ValueError as error:  # e.g. an impossible date
        raise ConfigError(f"not valid YAML ({error})", where=where) from error
    except RecursionError as error:
        raise ConfigError("nested too deeply", where=where, expected="sections of keys and values") from error
    if not isinstance(raw, dict):
        raise ConfigError(
            "holds no sections",
            where=where,
            found="nothing" if raw is None else type(raw).__name__,
            expected="vehicle:, signals: and so on",
        )
    if duplicate:
        raise ConfigError(f"key given twice: {duplicate[0]}", where=f"{where}:{duplicate[1]}")
    changed = _apply_overrides(raw, overrides)
    try:
        config = Config.model_validate(raw)
    except ValidationError as error:
        raise _explain(error, node, where, changed) from error
    paths = [["signals", role] for role in config.signals]
    config.note_origins({".".join(path): _origin(path, node, where, changed) for path in paths})
    return config


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
            target[last] = yaml.load(value, Loader=_LOADER)
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise ConfigError(f"--set {key}: not a YAML value", found=value) from error
        changed.add(key.strip())
    return changed


def _explain(error: ValidationError, node: yaml.Node | None, where: str, changed: set[str]) -> ConfigError:
    problems = error.errors(include_url=False)
    # a misspelt key is also missing under its right name: what was written tells more
    first = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    cause = first.get("ctx", {}).get("error")
    path = [
        str(p)
        for p in (*first["loc"], *(cause.keys if isinstance(cause, MisplacedError) else ()))
        if p != "[key]"
    ]
    key = ".".join(path) or "(whole config)"
    origin = _origin(path, node, where, changed)
    message = first["msg"].removeprefix("Value error, ")
    if first["type"] == "missing":
        return ConfigError(f"{key}: is missing", where=origin, expected="a value" + _more(problems))
    if first["type"] == "extra_forbidden":
        return ConfigError(f"{key}: unknown key", where=origin, expected=_known_keys(path) + _more(problems))
    if first["type"] == "value_error":
        return ConfigError(f"{key}: {message}{_more(problems)}", where=origin)
    found = first.get("input")
    shown = found if isinstance(found, str | int | float | bool) or found is None else type(found).__name__
    return ConfigError(key, where=origin, found=shown, expected=_plain(message) + _more(problems))


def _origin(path: list[str], node: yaml.Node | None, where: str, changed: set[str]) -> str:
    """Return where the key of ``path`` was written: "truck.yaml:31", or the command line."""
    key = ".".join(path)
    overridden = any(f"{key}.".startswith(f"{c}.") or c.startswith(f"{key}.") for c in changed)
    return "--set" if overridden else f"{where}:{_line_of(node, path)}"


#: pydantic's words -> words for somebody who writes YAML
_WORDS = {"a valid ": "a ", "a integer": "a whole number", "a tuple": "a list", "a dictionary": "a section"}


def _plain(message: str) -> str:
    message = message.removeprefix("Input should be ")
    for theirs, ours in _WORDS.items():
        message = message.replace(theirs, ours)
    return message.partition(", unable")[0].partition(" or instance of")[0]


def _more(problems: list[Any]) -> str:
    return f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""


def _known_keys(path: list[str]) -> str:
    """Return the keys that the section of ``path`` may have."""
    section: Any = Config
    for part in path[:-1]:
        fields = getattr(section, "model_fields", {})
        if part in fields:
            section = fields[part].annotation
            section = next((a for a in get_args(section) if hasattr(a, "model_fields")), section)
    return "one of " + ", ".join(section.model_fields)


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


def _duplicate_key(node: yaml.Node | None, seen: set[int]) -> tuple[str, int] | None:
    """Return the first key that a mapping has twice, with its line (YAML itself would keep the last).

    ``seen`` holds the nodes already looked at: an alias may name one again, or name what holds it.
    """
    if id(node) in seen:
        return None
    seen.add(id(node))
    children: list[yaml.Node] = []
    if isinstance(node, yaml.MappingNode):
        keys: set[str] = set()
        for key, value in node.value:
            if key.value in keys:
                return str(key.value), key.start_mark.line + 1
            keys.add(key.value)
            children.append(value)
    elif isinstance(node, yaml.SequenceNode):
        children = node.value
    return next((found for child in children if (found := _duplicate_key(child, seen))), None)
