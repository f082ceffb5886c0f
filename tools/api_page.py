"""Writes docs/api.md from the docstrings of the public names, so that it cannot be wrong.

``python tools/api_page.py --write``; a test holds page and docstrings together.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import canest

PAGE = Path(__file__).resolve().parent.parent / "docs" / "api.md"

HEAD = """# Python API

`import canest` offers what the command line does, for notebooks and programs. [A notebook](notebook.md) shows
it at work. Each name is imported when it is first used. `import canest` itself costs 2 ms.

pandas, polars and pyarrow are optional. A table of any of them goes in; `to_pandas()` needs pandas
(`pip install pandas`).

## What is public

Versions follow semantic versioning. These are kept within a major version:

| what | where it is listed |
|---|---|
| the names of this page, with their arguments and attributes | this page |
| commands and their options | `canest --help` |
| config keys and roles | [config.md](config.md) |
| estimators and their options | [estimators.md](estimators.md) |
| JSON keys of `--json` outputs, and of diagnosis.json | what the commands write |
| the columns of est.csv and est.parquet | [README](../README.md) |
| messages and signals of the broadcast | `dbc/canest.dbc` |
| names of metrics | [service.md](service.md) |

A name that is replaced stays as an alias for one minor version at least, with a note in the changelog. Before
1.0 a minor version may break what a patch version may not.

What [extending.md](extending.md) imports is public too, for packages that add an effect or an estimator.
Everything else is private: modules below `canest.` that neither page names, and names with an underscore.

The estimates themselves are no contract: a better estimator changes numbers, and the changelog lists it.

## At any rate

Tables may have 1 to 1000 rows a second. Between rows, values hold; in tables of less than 8 rows a second,
columns that are named by roles go along lines, and what lies between two gears counts as a shift. Two rows a
second lose next to nothing. At one, every launch and gear change is half seen:

| rows per second | demo drive, mass RMS | launches-flat, mass RMS | mixed-9t, mass RMS |
|---|---|---|---|
| 50 | 1.6 % | 0.3 % | 0.4 % |
| 10 | 1.5 % | 0.4 % | 0.6 % |
| 5 | 1.5 % | 1.0 % | 0.8 % |
| 2 | 0.9 % | 1.2 % | 0.9 % |
| 1 | 0.7 % | 1.2 % | 4.4 % |

(The columns of the simulated drives as `canest.read_signals` gives them, every n-th row kept.)

## Empty cells

An empty cell (NaN, null) means "not available", until the column has a number again. Where each row has
only what has changed, as after an outer join, fill the table first: `table.ffill()` of pandas.
"""

_SECTIONS = ("Args:", "Returns:", "Attributes:", "Example:")
_TITLES = {
    "Functions": inspect.isfunction,
    "Results": dataclasses.is_dataclass,
    "Vehicle, config and pipeline": lambda value: inspect.isclass(value) and not _is_small(value),
    "Codes": lambda value: inspect.isclass(value) and issubclass(value, enum.Enum),
    "Errors": lambda value: inspect.isclass(value) and issubclass(value, Exception),
}


def _is_small(value: type) -> bool:
    return issubclass(value, enum.Enum | Exception) or dataclasses.is_dataclass(value)


def signature(name: str, value: Any) -> str:
    """Return how a function is called, one line."""
    shown = (
        f"{name}{inspect.signature(value)}".replace("'", "").replace("(self, ", "(").replace("(self)", "()")
    )
    return shown.replace("VehicleFacts", "Vehicle").removesuffix(" -> None" if inspect.isclass(value) else "")


def members(cls: type) -> Iterator[tuple[str, Any]]:
    """Yield the public methods and properties that a class of ours defines."""
    for base in reversed([c for c in cls.__mro__ if c.__module__.startswith("canest.")]):
        for name, value in vars(base).items():
            plain = value.__func__ if isinstance(value, staticmethod | classmethod) else value
            if not name.startswith("_") and (inspect.isfunction(plain) or isinstance(plain, property)):
                yield name, plain


def text_of(docstring: str) -> str:
    """Return a docstring as markdown: its sections as lists, its example as code."""
    parts, section = [], ""
    for block in re.split(r"^(\w+:)$", docstring, flags=re.MULTILINE):
        if block in _SECTIONS:
            section = block
        elif section == "Example:":
            lines = [line.strip("\n") for line in inspect.cleandoc(block).splitlines()]
            parts.append("```pycon\n" + "\n".join(lines) + "\n```")
            section = ""
        elif section in ("Args:", "Attributes:"):
            body, rest = _indented(block)
            entries = re.split(r"\n(?=\S)", inspect.cleandoc(body))
            parts.append("\n".join("- " + re.sub(r"\s*\n\s*", " ", _coded(entry)) for entry in entries))
            parts.append(inspect.cleandoc(rest))
            section = ""
        elif section:
            body, rest = _indented(block)
            parts += [f"{section[:-1]}: " + inspect.cleandoc(body).strip(), inspect.cleandoc(rest)]
            section = ""
        else:
            parts.append(inspect.cleandoc(block))
    return "\n\n".join(part for part in parts if part) + "\n"


def _indented(block: str) -> tuple[str, str]:
    """Part what is indented below a section's title from what follows it."""
    lines = block.strip("\n").splitlines()
    end = next((i for i, line in enumerate(lines) if line and not line.startswith(" ")), len(lines))
    return "\n".join(lines[:end]), "\n".join(lines[end:])


def _coded(entry: str) -> str:
    names, _, text = entry.partition(": ")
    return ", ".join(f"`{name.strip()}`" for name in names.split(",")) + ": " + text


def page() -> str:
    """Return the page's text."""
    parts = [HEAD]
    values = {name: getattr(canest, name) for name in canest.__all__ if name != "estimators"}
    for title, belongs in _TITLES.items():
        parts.append(f"## {title}\n")
        for name, value in values.items():
            if belongs(value):
                parts.append(_entry(name, value))
    parts.append(
        "## Estimators\n\n`canest.estimators` holds the plain estimators, for a regression of one's own; see "
        "[estimators.md](estimators.md).\n"
    )
    return "\n".join(parts)


def _entry(name: str, value: Any) -> str:
    doc = inspect.getdoc(value) or ""
    if inspect.isfunction(value):
        return f"### `{signature(name, value)}`\n\n{text_of(doc)}"
    if issubclass(value, enum.Enum):
        rows = "\n".join(f"| {int(member)} | `{member.name}` |" for member in value)
        return f"### `{name}`\n\n{text_of(doc)}\n| code | name |\n|---|---|\n{rows}\n"
    if issubclass(value, Exception):
        base = value.__bases__[0].__name__
        return f"### `{name}({base})`\n\nExit code {value.exit_code}. {text_of(doc)}"
    title = signature(name, value) if name == "Pipeline" else name
    text = f"### `{title}`\n\n{text_of(doc)}"
    if value.__name__ == "Config":  # its keys have a page of their own
        return (
            text + "\nIts keys are attributes (`config.vehicle.mass_max_kg`); see [config.md](config.md).\n"
        )
    for member, found in members(value):
        if isinstance(found, property):
            text += f"\n#### `{name}.{member}`\n\n{text_of(inspect.getdoc(found) or '')}"
        elif name != "Vehicle":
            text += f"\n#### `{name}.{signature(member, found)}`\n\n{text_of(inspect.getdoc(found) or '')}"
    return text


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page())
