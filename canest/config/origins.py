"""Where the keys of a config were written: the lines of its file, and what the command line changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import yaml

from canest.config.yaml_loader import name_of
from canest.core.errors import ConfigError

KeyPath = tuple[str, ...]  #: ("vehicle", "gear_ratios", "3")


@dataclass(frozen=True, eq=False)
class Origins:
    """Finds where somebody wrote a key.

    file: its name. lines: the line of every key in it.
    options: keys that the command line has set -> its option.
    All are equal: configs of the same content are the same config, whoever wrote them.
    """

    file: str = ""
    lines: Mapping[KeyPath, int] = field(default_factory=dict)
    options: Mapping[KeyPath, str] = field(default_factory=dict)

    def option(self, path: KeyPath) -> str:
        """Return the option that has set a key, something within it or what holds it; '' for none."""
        for key, option in self.options.items():
            common = min(len(key), len(path))
            if common and key[:common] == path[:common]:
                return option
        return ""

    def of(self, path: KeyPath) -> str:
        """Return an option, or file and line of a key ("truck.yaml:31"), or of the nearest one above it."""
        if option := self.option(path):
            return option
        known = next((n for n in range(len(path), 0, -1) if path[:n] in self.lines), 0)
        return f"{self.file}:{self.lines.get(path[:known], 1)}" if self.file else ""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Origins)

    __hash__ = None  # type: ignore[assignment]


def lines_of(root: yaml.Node, file: str) -> dict[KeyPath, int]:
    """Return the line of every key and list entry of a YAML document.

    Errors: ConfigError for a key given twice (YAML itself would keep the last).
    """
    lines: dict[KeyPath, int] = {}
    seen: set[int] = set()

    def walk(node: yaml.Node, path: KeyPath) -> None:
        lines.setdefault(path, node.start_mark.line + 1)
        if id(node) in seen:  # an alias may name a node again, or name what holds it
            return
        seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                inner, line = (*path, name_of(key)), key.start_mark.line + 1
                if inner in lines:
                    raise ConfigError(f"key given twice: {'.'.join(inner)}", where=f"{file}:{line}")
                lines[inner] = line
                walk(value, inner)
        elif isinstance(node, yaml.SequenceNode):
            for i, value in enumerate(node.value):
                walk(value, (*path, str(i)))

    walk(root, ())
    return lines
