"""The live terminal view: mass and grade with their history, from broadcast frames alone."""

from __future__ import annotations

import math
from collections import Counter, deque
from typing import TYPE_CHECKING

from canest.core.gates import LABELS
from canest.decode import j1939
from canest.node.estimate_frame import NOT_AVAILABLE_STATUS, STATUS_NAMES, Estimate, decode
from canest.telemetry.status_view import age

if TYPE_CHECKING:
    from rich.console import RenderableType

BLOCKS = "▁▂▃▄▅▆▇█"
HISTORY = 60  #: points of a sparkline
LOST_S = 2.0  #: without a frame for this long, the sender is gone
_COLOURS = {"valid": "green", "converging": "yellow", "unestimated": "cyan"}


def sparkline(values: list[float], low: float | None = None, high: float | None = None) -> str:
    """Return one block character per value between ``low`` and ``high`` (default: the values' own range).

    NaN is a blank; equal values lie in the middle.
    """
    known = [v for v in values if not math.isnan(v)]
    if not known:
        return " " * len(values)
    low = min(known) if low is None else low
    high = max(known) if high is None else high
    span = high - low
    marks = []
    for value in values:
        if math.isnan(value):
            marks.append(" ")
        else:
            share = (value - low) / span if span > 0 else 0.5
            marks.append(BLOCKS[min(len(BLOCKS) - 1, max(0, int(share * len(BLOCKS))))])
    return "".join(marks)


_POINT_S = 1.0  #: between points of the sparklines


class LiveView:
    """Collects broadcasts of one group; ask it for a picture as often as you like."""

    def __init__(self, pgn: int, title: str) -> None:
        self.title = title
        self.bus_fault = ""  #: what is wrong with the bus, '' while it is up
        self._pgn = pgn
        self.estimate = Estimate()
        self.counters: Counter[str] = Counter()
        self.source: int | None = None
        self._mass: deque[float] = deque(maxlen=HISTORY)
        self._grade: deque[float] = deque(maxlen=HISTORY)
        self._last_s = -math.inf
        self._known: tuple[Estimate, float] | None = None
        self._point_at_s = -math.inf
        self._expected: int | None = None

    def take(self, can_id: int, payload: bytes, now_s: float) -> bool:
        """Take a frame; True when it was a sound broadcast of our group. ``now_s``: monotonic."""
        if j1939.pgn_of(can_id) != self._pgn:
            return False
        received = decode(payload, can_id)
        if received is None or not received.intact:
            self.counters["damaged"] += 1
            return False
        self.counters["frames"] += 1
        source = j1939.source_of(can_id)
        if source == self.source and received.counter != self._expected:
            self.counters["lost"] += (received.counter - (self._expected or 0)) % 16
        self.source, self._expected = source, (received.counter + 1) % 16
        self.estimate, self._last_s = received.estimate, now_s
        if math.isfinite(self.estimate.mass_kg):
            self._known = self.estimate, now_s
        if now_s >= self._point_at_s:
            self._point_at_s = now_s + _POINT_S
            self._mass.append(self.estimate.mass_kg)
            self._grade.append(self.estimate.grade)
        return True

    def render(self, now_s: float) -> RenderableType:
        """Return the picture for rich."""
        from rich.markup import escape
        from rich.panel import Panel
        from rich.table import Table

        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim", min_width=6)
        table.add_column(justify="right", min_width=12)
        table.add_column(justify="right", min_width=10)
        table.add_column()
        e = self.estimate
        mass, mass_std = _number(e.mass_kg, "{:,.0f} kg"), _spread(e.mass_std_kg, "{:,.0f} kg")
        grade, grade_std = _number(100 * e.grade, "{:+.2f} %"), _spread(100 * e.grade_std, "{:.2f} %")
        table.add_row("mass", mass, mass_std, sparkline(list(self._mass)))
        table.add_row("grade", grade, grade_std, sparkline(list(self._grade)))
        if known := self._last_known(now_s):
            table.add_row("known", *known, "")
        return Panel(
            table,
            title=escape(self.title),
            subtitle=self._footer(now_s),
            title_align="left",
            subtitle_align="left",
            width=98,
        )

    def line(self, now_s: float) -> str:
        """Return the numbers of the moment as one line of plain text."""
        from rich.text import Text

        e = self.estimate
        mass = f"{_number(e.mass_kg, '{:,.0f} kg')} {_spread(e.mass_std_kg, '{:,.0f} kg')}"
        grade = f"{_number(100 * e.grade, '{:+.2f} %')} {_spread(100 * e.grade_std, '{:.2f} %')}"
        if known := self._last_known(now_s):
            mass = f"- (last {' '.join(known)})"
        return f"mass {mass:<20} grade {grade:<18} {Text.from_markup(self._footer(now_s)).plain}"

    def _last_known(self, now_s: float) -> tuple[str, str] | None:
        """Return the last mass and its age while there is none of now."""
        if self._known is None or math.isfinite(self.estimate.mass_kg):
            return None
        estimate, then_s = self._known
        return f"{estimate.mass_kg:,.0f} kg", f"{age(now_s - then_s)} ago"

    def _footer(self, now_s: float) -> str:
        from rich.markup import escape

        age_s = now_s - self._last_s
        if self.bus_fault and age_s > LOST_S:
            return f"[red]the bus is {escape(self.bus_fault)}[/red]"
        if math.isinf(age_s):
            return f"waiting for PGN {self._pgn:#x}: is a canest broadcasting on this bus?"
        if age_s > LOST_S:
            return f"[red]no broadcast for {age_s:.0f} s[/red]"
        status = STATUS_NAMES[self.estimate.status]
        parts = [f"[{_COLOURS.get(status, 'red')}]{status}[/]"]
        gate = LABELS.get(self.estimate.gate, "")
        if gate:
            parts.append(f"gate {gate}")
        elif self.estimate.status != NOT_AVAILABLE_STATUS:
            parts.append("learning")
        parts.append(f"from {self.source:#04x}, {self.counters['frames']:,} frames")
        parts += [f"{self.counters[what]:,} {what}" for what in ("lost", "damaged") if self.counters[what]]
        return " · ".join(parts)


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else form.format(value)


def _spread(value: float, form: str) -> str:
    return "" if math.isnan(value) else "± " + form.format(value)
