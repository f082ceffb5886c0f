"""Which vehicle a log is of, and which config is its: a table of rules, the first that fits counts.

A rule looks at the log's path below SOURCE, or, as `vin:PATTERN`, at the VIN that the log carries. What no
rule fits is listed; nothing is guessed.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml

from canest.config.limits import mistake_in_yaml, refuse_excess
from canest.config.yaml_loader import LOADER
from canest.core.errors import ConfigError
from canest.fleet.source import fits

COLUMNS = ("pattern", "vehicle", "config")
VIN_MARK = "vin:"


@dataclass(frozen=True, slots=True)
class Rule:
    """Logs that fit a pattern are of a vehicle and have a config. vehicle: '' for the VIN in the log.

    where: file and line, for messages.
    """

    pattern: str
    vehicle: str
    config: str
    where: str = ""

    @property
    def asks_for_vin(self) -> bool:
        """Return whether only the log's content decides which vehicle it is."""
        return self.pattern.startswith(VIN_MARK) or not self.vehicle

    def may_fit(self, name: str) -> bool:
        """Return whether a log of this path fits, as far as its path shows."""
        return self.pattern.startswith(VIN_MARK) or fits(name, self.pattern)

    def fits_vin(self, vin: str) -> bool:
        """Return whether a log that may fit does, with the VIN that it carries ('' for none)."""
        if not self.pattern.startswith(VIN_MARK):
            return bool(self.vehicle or vin)
        return bool(vin) and fnmatchcase(vin, self.pattern.removeprefix(VIN_MARK).strip().upper())


@dataclass(frozen=True, slots=True)
class Manifest:
    """All rules, in order."""

    rules: tuple[Rule, ...]

    def rules_for(self, name: str) -> list[Rule]:
        """Return what may decide about a log: rules in order up to the first that its path alone decides."""
        found = []
        for rule in self.rules:
            if rule.may_fit(name):
                found.append(rule)
                if not rule.asks_for_vin:
                    break
        return found


def read_manifest(path: str | Path) -> Manifest:
    """Read a manifest: CSV with the header pattern,vehicle,config, or YAML.

    Configs are files beside the manifest, paths, or names of shipped ones.
    Errors: ConfigError that names file and line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"cannot read the manifest: {reason}", where=str(path)) from None
    rows = _yaml_rows(text, str(path)) if path.suffix.lower() in (".yaml", ".yml") else _csv_rows(text, path)
    rules = tuple(_rule(row, where, path.parent) for where, row in rows)
    if not rules:
        raise ConfigError("the manifest has no rules", where=str(path), expected=",".join(COLUMNS))
    return Manifest(rules)


def _csv_rows(text: str, path: Path) -> Iterator[tuple[str, dict[str, str]]]:
    lines = csv.reader(io.StringIO(text))
    header = [cell.strip().lower() for cell in next(lines, [])]
    if sorted(header) != sorted(COLUMNS):
        raise ConfigError(
            "not the header of a manifest", where=f"{path}:1", found=",".join(header),
            expected=",".join(COLUMNS),
        )  # fmt: skip
    for cells in lines:
        if not any(cell.strip() for cell in cells) or cells[0].lstrip().startswith("#"):
            continue
        where = f"{path}:{lines.line_num}"
        if len(cells) != len(header):
            expected = f"{len(header)}: {','.join(header)}"
            raise ConfigError(
                "row of a manifest", where=where, found=f"{len(cells)} cells", expected=expected
            )
        yield where, {name: cell.strip() for name, cell in zip(header, cells, strict=True)}


def _yaml_rows(text: str, where: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the rows of a list of rules, or of `logs:` (such a list) and `vins:` (VIN: config)."""
    try:
        refuse_excess(text, where)
        content = yaml.load(text, Loader=LOADER)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        problem, line = mistake_in_yaml(error, text)
        raise ConfigError(f"not valid YAML ({problem})", where=where + line) from None
    if isinstance(content, list):
        content = {"logs": content}
    if not isinstance(content, Mapping) or not content.keys() <= {"logs", "vins"}:
        raise ConfigError("no manifest", where=where, expected="a list of rules, or logs: and vins:")
    vins = content.get("vins") or {}
    if not isinstance(vins, Mapping):
        raise ConfigError("vins", where=where, found=type(vins).__name__, expected="VIN: config")
    for vin, config in vins.items():
        yield f"{where}: vins.{vin}", {"pattern": f"{VIN_MARK}{vin}", "vehicle": "", "config": str(config)}
    for number, row in enumerate(content.get("logs") or []):
        place = f"{where}: logs.{number}"
        if not isinstance(row, Mapping) or not row.keys() <= set(COLUMNS):
            raise ConfigError("rule", where=place, found=str(row), expected=", ".join(COLUMNS))
        yield place, {name: _text(row.get(name)) for name in COLUMNS}


def _rule(row: Mapping[str, str], where: str, folder: Path) -> Rule:
    for name in ("pattern", "config"):
        if not row[name]:
            raise ConfigError(f"{name}: is empty", where=where, expected="a value")
    config = row["config"]
    beside = folder / Path(config).expanduser()
    with suppress(OSError):  # a name too long: loading it raises the error
        config = str(beside) if beside.is_file() else config
    return Rule(row["pattern"], row["vehicle"], config, where)


def _text(value: Any) -> str:
    return "" if value is None else str(value).strip()
