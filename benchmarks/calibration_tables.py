"""Tables of the calibration benchmark: pooled figures, for the terminal and as a page of the docs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

_POOLED_RMS = ("mass_rms", "rms_120", "grade_rms")
_WORST = ("mass_max", "settled_max")
COLUMNS = ("mass_rms", "mass_max", "rms_120", "settled_max", "grade_rms", "in2", "in3", "grade_in2")
COLUMNS += ("grade_in3", "std", "valid", "valid_wrong", "nis")


def pooled(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Pool runs: root mean square of RMS figures, worst of maxima, mean of shares, median of stds."""
    out = {}
    for key in COLUMNS:
        values = np.array([row[key] for row in rows])
        if key in _POOLED_RMS:
            out[key] = float(np.sqrt(np.mean(values * values)))
        elif key in _WORST:
            out[key] = float(values.max())
        elif key == "std":
            out[key] = float(np.median(values))
        else:
            out[key] = float(np.nanmean(values))
    return out


def table(rows: list[dict[str, Any]], families: Sequence[str]) -> Iterator[str]:
    """Yield the lines of the table, by family and accelerometer, and over all."""
    yield f"{'family':12s}{'acc':>4s}{'runs':>5s}" + "".join(f"{c:>12s}" for c in COLUMNS)
    groups = [(f, a) for f in families for a in (False, True)]
    for name, accelerometer in groups:
        mine = [r for r in rows if r["family"] == name and r["accelerometer"] == accelerometer]
        if mine:
            yield _line(name, "yes" if accelerometer else "no", mine)
    for accelerometer in (False, True):
        mine = [r for r in rows if r["accelerometer"] == accelerometer]
        if mine:
            yield _line("all", "yes" if accelerometer else "no", mine)


def _line(name: str, accelerometer: str, rows: list[dict[str, Any]]) -> str:
    figures = pooled(rows)
    return f"{name:12s}{accelerometer:>4s}{len(rows):5d}" + "".join(f"{figures[c]:12.2f}" for c in COLUMNS)


#: columns of the page: figure, heading
PAGE = {
    "rms_120": "mass RMS from 120 s, %",
    "settled_max": "worst once settled, %",
    "std": "median std, %",
    "in2": "in 2 std, %",
    "in3": "in 3 std, %",
    "grade_rms": "grade RMS, degrees",
    "grade_in2": "grade in 2 std, %",
    "grade_in3": "grade in 3 std, %",
    "valid": "valid after 120 s, %",
    "valid_wrong": "valid but off by 8 %, %",
    "nis": "NIS",
}


def page(rows: list[dict[str, Any]], families: Sequence[str], command: str) -> str:
    """Return the table as a page of the docs."""
    drives = len({(r["family"], r["seed"]) for r in rows})
    lines = [
        "# How right, and how right about how right",
        "",
        f"{drives} simulated drives with loads of 9 to 36 t (city: two changes of load in long stops), each",
        "from starts of 9, 21 and 36 t; starred ones carry undeclared errors. RMS is over all samples, gated",
        "ones and stops with a changed load too; `settled` means 60 s of open gates after a change. In n",
        "std: the truth lies within n standard deviations, from 60 s on. NIS: normalised innovation squared,",
        "1 when honest.",
        "",
        f"    {command} -o docs/measured/calibration.md",
        "",
        "| drives | accelerometer | " + " | ".join(PAGE.values()) + " |",
        "|---|---|" + "---|" * len(PAGE),
    ]
    for name in [*families, ""]:
        for accelerometer in (False, True):
            mine = [r for r in rows if r["accelerometer"] == accelerometer and name in ("", r["family"])]
            if mine:
                figures = pooled(mine)
                cells = " | ".join(f"{figures[c]:.2f}" for c in PAGE)
                lines.append(f"| {name or '**all**'} | {'yes' if accelerometer else 'no'} | {cells} |")
    return "\n".join([*lines, ""])
