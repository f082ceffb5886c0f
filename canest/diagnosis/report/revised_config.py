"""The config with what was found: the user's own text with the additions, where that means the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from canest.config.load import parse_config
from canest.config.schema import Config
from canest.core.errors import CanestError, ConfigError
from canest.core.roles import ROLES
from canest.diagnosis.run import Diagnosis
from canest.diagnosis.sentences import alternatives
from canest.system.shipped_files import shipped
from canest.vehicle.effects import added_to, effect_class, effect_from_config, plugin_roles
from canest.vehicle.facts import Vehicle

_WIDTH = 100
_INDENT = "  "


def revised_config(diagnosis: Diagnosis) -> Config:
    """Return the config with the selected effects, and only those extra signals that they use.

    Errors: ConfigError when the result would not be a valid config.
    """
    config = _with_found(diagnosis)
    used = {effect_from_config(e).signal for e in config.effects}
    known = {*ROLES, *used}
    if not known.issuperset(config.signals):
        known |= plugin_roles()
    signals = {r: s for r, s in config.signals.items() if r in known}
    config = config.model_copy(update={"signals": signals, "dbc": _resolvable(config.dbc)})
    return parse_config(_dumped(config), "revised config")


def _with_found(diagnosis: Diagnosis) -> Config:
    """Return the config with the selected effects in its list, values rounded to what is known of them."""
    base = list(diagnosis.config.effects)
    added: list[dict[str, Any]] = []
    for chosen in diagnosis.search.chosen:
        entry = chosen.effect().to_config()
        digits = max(0, 2 - int(np.floor(np.log10(max(chosen.std, 1e-12)))))
        name = chosen.candidate.parameter
        least = _least(entry["effect"], name, [*base, *added], diagnosis.config.vehicle)
        entry[name] = max(round(float(entry[name]), digits), least)
        added.append(entry)
    return diagnosis.config.model_copy(update={"effects": (*base, *added)})


def _least(effect: str, name: str, before: Sequence[Mapping[str, Any]], vehicle: Vehicle) -> float:
    """Return the least value with which nothing that the vehicle declares becomes negative."""
    info = effect_class(effect).parameters[name]
    if not info.declared:
        return info.low
    others = added_to(info.declared, before)
    return max(info.low, -float(getattr(vehicle, info.declared)) - others)


def revised_text(diagnosis: Diagnosis, config: Config, original: str, name: str) -> str:
    """Return revised.yaml.

    config: what `revised_config` gave. original: the text of the config that the diagnosis began with, named
    `name`. Its comments and order are kept where its text with the additions reads back as `config`; else
    (the command line changed the config, or its layout is unusual) the config is written anew.
    """
    notes = _notes(diagnosis)
    header = _header(diagnosis, name)
    try:
        text = header + _spliced(original, config, notes)
        if parse_config(text) == config:
            return text
    except (CanestError, yaml.YAMLError):
        pass
    return header + _dumped(config, notes)


def _header(diagnosis: Diagnosis, name: str) -> str:
    logs = ", ".join(p.drive.name for p in diagnosis.problem.parts)
    lines = [f"{name} as revised by `canest diagnose` from {logs}.", diagnosis.finding, *diagnosis.details]
    chosen = diagnosis.search.chosen
    lines.append("What it added: see effects." if chosen else "Nothing was added.")
    return "".join(f"# {part}\n" for line in lines for part in _wrapped(line)) + "\n"


def _wrapped(line: str) -> list[str]:
    import textwrap

    return textwrap.wrap(line, _WIDTH - 2) or [""]


def _notes(diagnosis: Diagnosis) -> dict[int, str]:
    """Return a comment per added effect: place in the list -> standard deviation and share."""
    first = len(diagnosis.config.effects)
    return {
        first + i: f"± {c.std:.2g} {c.candidate.info.unit}".rstrip()
        + f", removes {100 * min(max(c.explained, 0.0), 1.0):.1f} % of the residual variance"
        + "".join(f", or {effect_class(n).in_words()}" for n in alternatives(c))
        for i, c in enumerate(diagnosis.search.chosen)
    }


def _spliced(text: str, config: Config, notes: Mapping[int, str]) -> str:
    """Put the effects, new signals and resolved DBC paths into the text of the config."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    if not isinstance(root, yaml.MappingNode) or root.flow_style:
        raise ConfigError("not a block of sections")
    sections = {key.value: value for key, value in root.value}
    keys = {key.value: key for key, _ in root.value}
    edits: list[tuple[int, int, str]] = []
    if config.effects:
        block = "effects:\n" + _effect_lines(config, notes)
        if "effects" in sections:
            end = _end_of_line(text, _end(sections["effects"]))
            edits.append((keys["effects"].start_mark.index, end, block))
        else:
            edits.append((len(text), len(text), ("" if text.endswith("\n") else "\n") + "\n" + block))
    signals = sections.get("signals")
    if isinstance(signals, yaml.MappingNode):
        have = {key.value for key, _ in signals.value}
        new = {r: s for r, s in config.signals.items() if r not in have}
        if new:
            if signals.flow_style:
                raise ConfigError("signals in flow style")
            column = " " * signals.start_mark.column
            at = _end_of_line(text, _end(signals))
            lines = "".join(f"\n{column}{_flow_scalar(r)}: {_flow(_source(s))}" for r, s in new.items())
            edits.append((at, at, lines))
    dbc = sections.get("dbc")
    if dbc is not None and [n.value for n in getattr(dbc, "value", [])] != list(config.dbc):
        edits.append((dbc.start_mark.index, _end(dbc), _flow(list(config.dbc))))
    for start, end, new_text in sorted(edits, reverse=True):
        text = text[:start] + new_text + text[end:]
    return text if text.endswith("\n") else text + "\n"


def _end(node: yaml.Node) -> int:
    """Return where a node's own text ends (a block's end mark lies behind the comments that follow it)."""
    if isinstance(node, yaml.MappingNode) and not node.flow_style and node.value:
        return _end(node.value[-1][1])
    if isinstance(node, yaml.SequenceNode) and not node.flow_style and node.value:
        return _end(node.value[-1])
    return int(node.end_mark.index)


def _end_of_line(text: str, at: int) -> int:
    end = text.find("\n", at)
    return len(text) if end < 0 else end


def _effect_lines(config: Config, notes: Mapping[int, str]) -> str:
    lines = []
    for i, entry in enumerate(config.effects):
        note = f"   # {notes[i]}" if i in notes else ""
        lines.append(f"{_INDENT}- {_flow(dict(entry))}{note}")
    return "\n".join(lines)


def _source(source: Any) -> dict[str, Any]:
    given: dict[str, Any] = source.model_dump(exclude_defaults=True)
    return given


def _flow(value: Any) -> str:
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=1000).strip()


def _dumped(config: Config, notes: Mapping[int, str] | None = None) -> str:
    """Write the keys that the user set, in the schema's order; one line per signal and effect."""
    raw = config.model_dump(mode="json", exclude_unset=True)
    parts = []
    for section in type(config).model_fields:
        if section not in raw:
            continue
        value = raw[section]
        if section == "effects":
            if config.effects:
                parts.append("effects:\n" + _effect_lines(config, notes or {}) + "\n")
        elif section == "signals":
            lines = "".join(
                f"{_INDENT}{_flow_scalar(r)}: {_flow(_source(s))}\n" for r, s in config.signals.items()
            )
            parts.append("signals:\n" + lines)
        elif isinstance(value, Mapping):
            parts.append(f"{section}:\n" + _lines_of(value))
        else:
            parts.append(f"{section}: {_flow(value)}\n")
    return "\n".join(parts)


def _lines_of(section: Mapping[str, Any]) -> str:
    return "".join(f"{_INDENT}{key}: {_flow_scalar(value)}\n" for key, value in section.items())


def _flow_scalar(value: Any) -> str:
    # PyYAML ends a lone scalar with the document's end mark
    return _flow(value).removesuffix("...").strip()


def _resolvable(names: Sequence[str]) -> tuple[str, ...]:
    """Return the DBC names so that they are found from any directory: shipped by name, others absolute."""
    found = []
    for name in names:
        local = Path(name).resolve()
        ours = local.is_file() and local != (shipped("dbc") / name).resolve()
        found.append(str(local) if ours else name)
    return tuple(found)
