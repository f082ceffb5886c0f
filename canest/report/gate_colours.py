"""How gates look in every report."""

from __future__ import annotations

from canest.core.gates import LABELS

#: gate -> (colour, what it means to a reader)
LOOKS: dict[str, tuple[str, str]] = {
    "stale": ("#7c3aed", "a needed signal is too old"),
    "invalid": ("#9333ea", "a needed signal is not available"),
    "reverse": ("#64748b", "reversing"),
    "low_speed": ("#64748b", "standing or crawling"),
    "brake": ("#dc2626", "braking"),
    "shift": ("#d97706", "shifting"),
    "driveline": ("#b45309", "driveline open or slipping"),
    "possible_brake": ("#f87171", "may be braking: no brake or pedal signal"),
    "retarder": ("#e11d48", "retarder at work"),
    "pto": ("#0e7490", "power take-off"),
    "turning": ("#0d9488", "curve"),
    "implausible": ("#a21caf", "signals contradict each other"),
    "low_excitation": ("#ca8a04", "force varies too little to learn from"),
    "recovery": ("#94a3b8", "filters settle after a gate"),
}
OPEN_COLOUR = "#0f766e"


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
