"""Writes the table of the estimator's constants in docs/theory.md from the code, so it cannot be wrong.

``python tools/constants_table.py --write``; a test holds page and code together.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from canest.estimators.default.constants import CONSTANTS
from canest.estimators.description import constant_rows

PAGE = Path(__file__).resolve().parent.parent / "docs" / "theory.md"
BEGIN, END = "<!-- constants: python tools/constants_table.py --write -->\n", "<!-- end of constants -->\n"


def table() -> str:
    """Return one row per constant, in the order of the code."""
    lines = ["| symbol | value | unit | in the code |", "|---|---|---|---|"]
    lines += [f"| {r.symbol} | {r.value:g} | {r.unit} | `{r.name}` |" for r in constant_rows(CONSTANTS)]
    return "\n".join(lines) + "\n"


def page(text: str) -> str:
    """Return a page with its table made anew."""
    pattern = re.escape(BEGIN) + ".*?" + re.escape(END)
    return re.sub(pattern, lambda _: f"{BEGIN}\n{table()}\n{END}", text, flags=re.DOTALL)


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    if "--write" in sys.argv:
        PAGE.write_text(page(text), encoding="utf-8")
    else:
        print(table())
