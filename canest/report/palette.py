"""The colours of figures and bars, for a light and a dark ground.

All but the gates' are those of Okabe and Ito (2008), which colour-blind readers can distinguish, darkened or
lightened until they stand out from their ground by 3 to 1 (WCAG 2.1, 1.4.11).
"""

from __future__ import annotations

INK, MUTED, GRID, GROUND = "#1c2733", "#5b697e", "#e6eaf0", "#ffffff"
BLUE, ORANGE, GREEN, RED, VIOLET = "#0072b2", "#b85c00", "#007a5a", "#c2451e", "#a8558a"

#: light -> dark
DARK: dict[str, str] = {
    GROUND: "#171d23", INK: "#eef2f5", MUTED: "#aab6c2", GRID: "#2c353e",
    BLUE: "#56b4e9", ORANGE: "#e69f00", GREEN: "#2fc79b", RED: "#ff8a5c", VIOLET: "#dd97b9",
    # further series
    "#d55e00": "#f0803c", "#009e73": "#3ddbae", "#cc79a7": "#e3a5c6", "#b8860b": "#d9b23c",
    "#56b4e9": "#8fd0f5", "#7c3aed": "#b79bff", "#8c510a": "#c98d4a", "#475569": "#c5ced6",
    "#dc2626": "#ff7b7b", "#65a30d": "#a3d65c", "#0e7490": "#4cc3dd", "#be185d": "#ff7fb0",
    "#4338ca": "#9a94ff", "#a16207": "#dcae52",
    # gates
    "#64748b": "#94a3b8", "#94a3b8": "#6f7f92", "#a21caf": "#e57cf0", "#e69f00": "#e6a921",
    "#1d4ed8": "#7ea6ff", "#0f766e": "#2dc5b8",
}  # fmt: skip


def both(colour: str) -> str:
    """Return a colour of the style sheet that follows the theme."""
    return f"light-dark({colour}, {DARK.get(colour, colour)})"
