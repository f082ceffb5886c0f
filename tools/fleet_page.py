"""Writes the tables of columns in docs/fleet.md (``--write``), else compares them with the code's."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

from canest.fleet.tables import POSITIONS, SAMPLES, TRIPS

PAGE = Path(__file__).resolve().parent.parent / "docs" / "fleet.md"
_TYPES = {
    "float64": "double", "float32": "float", "int64": "int64", "string": "string",
    "word": "string (dictionary)", "time": "timestamp (us)",
}  # fmt: skip


def table(name: str, columns: Mapping[str, tuple[str, str]]) -> str:
    """Return a table of columns between its marks."""
    rows = [f"| `{column}` | {_TYPES[kind]} | {text} |" for column, (kind, text) in columns.items()]
    lines = [f"<!-- columns of {name} -->", "| column | type | meaning |", "|---|---|---|", *rows]
    return "\n".join([*lines, f"<!-- end of {name} -->"])


def page() -> str:
    """Return the page with the tables as they are now."""
    text = PAGE.read_text(encoding="utf-8")
    for name, columns in (("trips", TRIPS), ("samples", SAMPLES), ("positions", POSITIONS)):
        mark = rf"<!-- columns of {name} -->.*?<!-- end of {name} -->"
        text = re.sub(mark, lambda _, n=name, c=columns: table(n, c), text, flags=re.DOTALL)
    return text


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    elif page() != PAGE.read_text(encoding="utf-8"):
        sys.exit("docs/fleet.md is not up to date: python tools/fleet_page.py --write")
