"""Writes the table of effects in docs/diagnosis.md from their classes, so it cannot be wrong.

``python tools/effects_table.py --write``; a test holds page and classes together.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from canest.vehicle.effects import EFFECTS, Effect

PAGE = Path(__file__).resolve().parent.parent / "docs" / "diagnosis.md"
BEGIN, END = "<!-- effects: python tools/effects_table.py --write -->\n", "<!-- end of effects -->\n"


def _drawn_over(effect: Effect) -> str:
    if effect.caused_by:
        return effect.caused_by.replace("_", " ")
    return f"`{effect.signal}`" if effect.signal else "its own force"


def table() -> str:
    """Return one row per effect, in the order of the list: what is fitted, its cause, what separates it."""
    lines = [
        "| effect | fitted | bounds | residual drawn over | separated from others by |",
        "|---|---|---|---|---|",
    ]
    for name, cls in EFFECTS.items():
        fitted = cls.fitted_parameter()
        p = cls.parameters[fitted]
        bounds = f"{p.low:g} to {p.high:g} {p.unit}".strip()
        cells = (f"`{name}`", f"`{fitted}`", bounds, _drawn_over(cls()), cls.separated_by or "-")
        lines.append(f"| {' | '.join(cells)} |")
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
