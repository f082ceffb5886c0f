"""Reads a YAML config and turns every mistake into one line: file, line, key, found, expected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import ValidationError

from canest.config.database_files import read_databases
from canest.config.limits import mistake_in_yaml, read_text, refuse_depth, refuse_excess
from canest.config.origins import KeyPath, Origins, lines_of
from canest.config.schema import Config
from canest.config.yaml_loader import LOADER
from canest.core.errors import ConfigError
from canest.core.nearest_name import expected_name
from canest.core.validation import first_mistake
from canest.system.shipped_files import find, is_file


def load_config(
    name: str | Path,
    overrides: Iterable[str] = (),
    options: Mapping[str, str] | None = None,
    *,
    databases: bool = True,
) -> Config:
    """Load a config by path or shipped name, with ``dotted.key=value`` overrides (values are YAML).

    options: keys that an option of the command line overrides -> that option, for messages (else --set).
    databases: read the DBC files too, which whoever decodes needs.
    Errors: ConfigError naming file, line and key of the first mistake, and how many more there are.
    """
    path = find("configs", str(name))
    config = parse_config(read_text(path), str(path), overrides, options)
    local = _beside(path, config.dbc)
    config = config if local == config.dbc else config.model_copy(update={"dbc": local})
    if config.road_map is not None:
        (road_map,) = _beside(path, [config.road_map])
        config = config.model_copy(update={"road_map": road_map})
    return read_databases(config) if databases else config


def _beside(config: Path, names: Iterable[str]) -> tuple[str, ...]:
    """Return the DBC names, those of files beside the config as paths that hold in any directory."""
    files = ((name, config.parent / name) for name in names)
    return tuple(str(file.resolve()) if is_file(file) else name for name, file in files)


def parse_config(
    text: str,
    where: str = "config",
    overrides: Iterable[str] = (),
    options: Mapping[str, str] | None = None,
) -> Config:
    """Validate YAML text; no file is read. ``where`` names it in errors, ``options`` as above.

    Errors: ConfigError.
    """
    try:
        refuse_excess(text, where)
        raw, lines = _sections(text, where)
    except yaml.YAMLError as error:
        problem, line = mistake_in_yaml(error, text)
        raise ConfigError(f"not valid YAML ({problem})", where=where + line) from error
    except ValueError as error:  # e.g. an impossible date
        raise ConfigError(f"not valid YAML ({error})", where=where) from error
    except RecursionError as error:
        raise ConfigError("nested too deeply", where=where, expected="sections of keys and values") from error
    changed = {key: (options or {}).get(key, "--set") for key in _apply_overrides(raw, overrides)}
    origins = Origins(where, lines, {tuple(key.split(".")): option for key, option in changed.items()})
    return validated(raw, origins)


def validated(raw: Mapping[str, Any], origins: Origins) -> Config:
    """Return the config of sections and keys; ``origins`` locates them. Errors: ConfigError."""
    try:
        config = Config.model_validate(raw)
    except ValidationError as error:
        raise explained(error, origins) from error
    config.note_origins(origins)
    return config


def _sections(text: str, where: str) -> tuple[dict[str, Any], dict[KeyPath, int]]:
    """Return what the sections hold, and the line of every key.

    Errors: ConfigError for keys given twice and for a document without sections, yaml.YAMLError, ValueError.
    """
    loader = LOADER(text)
    try:
        node = loader.get_single_node()
        if isinstance(node, yaml.SequenceNode):  # whatever is in it
            raise _no_sections("list", where)
        lines = lines_of(node, where) if isinstance(node, yaml.MappingNode) else {}
        raw = loader.construct_document(node) if node is not None else None
    finally:
        loader.dispose()
    if not isinstance(raw, dict):
        raise _no_sections("nothing" if raw is None else type(raw).__name__, where)
    return raw, lines


def _no_sections(found: str, where: str) -> ConfigError:
    expected = "vehicle:, signals: and so on"
    return ConfigError("holds no sections", where=where, found=found, expected=expected)


def _apply_overrides(raw: dict[str, Any], overrides: Iterable[str]) -> set[str]:
    changed = set()
    for override in overrides:
        key, equals, value = override.partition("=")
        if not equals or not key:
            raise ConfigError("malformed --set", found=override, expected="dotted.key=value")
        target = raw
        *parents, last = key.strip().split(".")
        refuse_depth(len(parents) + 1, "--set")
        for part in parents:
            child = target.setdefault(part, {})
            if not isinstance(child, dict):
                raise ConfigError(f"--set {key}: {part} is not a section")
            target = child
        try:
            refuse_excess(value, f"--set {key}")
            target[last] = yaml.load(value, Loader=LOADER)
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise ConfigError(f"--set {key}: not a YAML value", found=value[:60]) from error
        changed.add(key.strip())
    return changed


def explained(error: ValidationError, origins: Origins, section: KeyPath = ()) -> ConfigError:
    """Return the first mistake in one line; ``section`` is what was validated, where that is a part."""
    mistake = first_mistake(error, section)
    key, origin = mistake.key or "(whole config)", origins.of(mistake.path)
    if origin.startswith("--") and origin != "--set":  # an option of its own: the key by another name
        key, origin = origin, ""
    match mistake.kind:
        case "missing":
            return ConfigError(f"{key}: is missing", where=origin, expected="a value" + mistake.more)
        case "unknown key":
            expected = _known_keys(mistake.path) + mistake.more
            return ConfigError(f"{key}: unknown key", where=origin, expected=expected)
        case "contradiction":
            return ConfigError(f"{key}: {mistake.words}{mistake.more}", where=origin)
    return ConfigError(key, where=origin, found=mistake.found, expected=mistake.words + mistake.more)


def _known_keys(path: KeyPath) -> str:
    """Return which key the section of ``path`` may have in its stead."""
    section: Any = Config
    for part in path[:-1]:
        fields = getattr(section, "model_fields", {})
        if part in fields:
            section = fields[part].annotation
            section = next((a for a in get_args(section) if hasattr(a, "model_fields")), section)
    kind = f"a key of {path[-2]}:" if path[1:] else "a section"
    return expected_name(path[-1], section.model_fields, kind, "canest config schema")
