"""Writes the tables of docs/estimators.md from the estimators' own descriptions, so they cannot be wrong.

``python tools/estimators_page.py --write``; a test holds page and descriptions together.
"""

from __future__ import annotations

import sys
from pathlib import Path

from canest.estimators.description import option_rows, shown
from canest.estimators.registry import BUILT_IN, describe

PAGE = Path(__file__).resolve().parent.parent / "docs" / "estimators.md"
MADE = "made by tools/estimators_page.py"


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def methods() -> str:
    """Return the table of all estimators of canest."""
    found = [describe(name) for name in ("canest", *(n for n in BUILT_IN if n != "canest"))]
    rows = [[f"`{d.name}`", d.text, d.source, ", ".join(d.needs)] for d in found]
    return _table(["name", "method", "source", "needs"], rows)


def options() -> str:
    """Return a table of options per options model, under the names of the estimators that have it."""
    models: dict[type, list[str]] = {}
    for name in BUILT_IN:
        models.setdefault(describe(name).options, []).append(name)
    parts = []
    for names in models.values():
        model = describe(names[0]).options
        rows = [
            [f"`{row.name}`", shown(row.default), row.unit, row.allowed, row.text]
            for row in option_rows(model)
        ]
        title = ", ".join(f"`{name}`" for name in names)
        presets = ", ".join(f"`{preset}`" for preset in model.presets) or "none"
        table = _table(["option", "default", "unit", "allowed", "meaning"], rows) if rows else "No options.\n"
        parts.append(f"### {title}\n\nPresets: {presets}.\n\n{table}")
    return "\n".join(parts)


def page(text: str) -> str:
    """Return the page with its made parts as they have to be."""
    for name, content in (("methods", methods()), ("options", options())):
        begin, end = f"<!-- {name}: {MADE} -->\n", f"<!-- end of {name} -->\n"
        head, rest = text.split(begin)
        text = f"{head}{begin}\n{content}\n{end}{rest.split(end)[1]}"
    return text


if __name__ == "__main__":
    made = page(PAGE.read_text(encoding="utf-8"))
    if "--write" in sys.argv:
        PAGE.write_text(made, encoding="utf-8")
    else:
        print(made)
