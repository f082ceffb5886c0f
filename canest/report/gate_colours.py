"""How gates look in every report: those that often follow each other differ for the colour-blind too."""

from __future__ import annotations

from canest.core.gates import LABELS
from canest.report.palette import GREEN

#: gate -> (colour, what it means to a reader)
LOOKS: dict[str, tuple[str, str]] = {
    "stale": ("#7c3aed", "a needed signal is too old"),
    "invalid": ("#cc79a7", "a needed signal is not available"),
    "reverse": ("#475569", "reversing"),
    "low_speed": ("#94a3b8", "standing or crawling"),
    "brake": ("#d55e00", "braking"),
    "shift": ("#e69f00", "shifting"),
    "driveline": ("#0072b2", "driveline open or slipping"),
    "possible_brake": ("#8c510a", "may be braking: no brake signal"),
    "retarder": ("#be185d", "retarder at work"),
    "pto": ("#009e73", "power take-off"),
    "turning": ("#56b4e9", "curve"),
    "implausible": ("#a21caf", "signals contradict each other"),
    "low_excitation": ("#b8860b", "force varies too little to learn from"),
    "recovery": ("#64748b", "filters settle after a gate"),
}
OPEN_COLOUR = GREEN


def look(gate: str) -> tuple[str, str]:
    """Return colour and meaning of a gate."""
    return LOOKS.get(gate, ("#64748b", gate.replace("_", " ")))


def spans_of(closures: list[tuple[int, int, int]], origin_us: int) -> dict[str, list[tuple[float, float]]]:
    """Return the closed stretches per gate name, in seconds since ``origin_us``."""
    spans: dict[str, list[tuple[float, float]]] = {}
    for first, end, code in closures:
        stretch = round((first - origin_us) * 1e-6, 2), round((end - origin_us) * 1e-6, 2)
        spans.setdefault(LABELS[code], []).append(stretch)
    return spans
