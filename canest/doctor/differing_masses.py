"""Controllers that report masses which differ."""

from __future__ import annotations

from collections.abc import Mapping

ROLE = "reported_mass"
#: senders that differ by more than this do not weigh the same vehicle, %
DIFFER_PCT = 2.0


def differing(masses_kg: Mapping[str, float]) -> list[str]:
    """Return that senders report masses which differ, nothing where they do not. masses_kg: by sender."""
    if len(masses_kg) < 2:
        return []
    low, high = min(masses_kg, key=masses_kg.__getitem__), max(masses_kg, key=masses_kg.__getitem__)
    apart_pct = 100.0 * (masses_kg[high] / masses_kg[low] - 1.0)
    if apart_pct <= DIFFER_PCT:
        return []
    both = f"{masses_kg[high]:,.0f} and {masses_kg[low]:,.0f} kg"
    return [
        f"{high} reports {apart_pct:.1f} % more than {low} ({both}): "
        "they do not weigh the same vehicle, or one does not weigh"
    ]
