"""`canest demo`: the daemon on a bundled drive, live, without any hardware."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import click

from canest.cli.options import Number, changes, override_options
from canest.system import terminal

if TYPE_CHECKING:
    from rich.console import RenderableType

    from canest.core.estimates import Estimates
    from canest.demo.session import Moment, Session
    from canest.offline.scoring import Score


EPILOG = """\b
Examples:
  canest demo                        three minutes of driving in ten seconds
  canest demo --speed 1              in real time
  canest demo --initial-mass 9000    from a start that is far off
  canest demo --estimator rlsmf      with the method of the 2005 paper

What happens: a recorded drive is sent, frame by frame, onto a loopback bus inside this process. The same
daemon that `canest run` starts listens there, estimates, and puts mass and grade back on the bus. What
you see is decoded from those broadcasts and compared with the drive's truth.
"""

REFRESH_HZ = 8.0
LINE_S = 1.0
HISTORY_MAX, HISTORY_MIN = 64, 16
#: columns that the panel needs beside the curves
_FRAME_WIDTH = 50
SETTLED_PCT = 5.0
_COLOURS = {"valid": "green", "converging": "yellow"}


@click.command(epilog=EPILOG)
@click.option(
    "--speed",
    type=Number(0.1, 60),
    default=20.0,
    show_default=True,
    metavar="FACTOR",
    help="Times real time.",
)
@override_options
def command(
    speed: float, overrides: tuple[str, ...], estimator: str | None, initial_mass: float | None
) -> int:
    """See mass and grade settle on a bundled drive, played to the daemon over a loopback bus."""
    from canest.demo.session import CONFIG, Session

    with Session(speed, *changes(CONFIG, overrides, estimator, initial_mass)) as session:
        show = _draw if sys.stdout.isatty() else _print
        show(session)
        return _result(session)


def _print(session: Session) -> None:
    """Print a line per second of real time, for pipes and logs."""
    print(f"{'time':>7}  {'mass':>22}  {'true':>9}  {'grade':>8}  {'true':>7}  status      gate", flush=True)
    for moment in session.play(LINE_S):
        e = moment.estimate
        print(
            f"{moment.event_s:6.1f}s  {_mass(e.mass_kg, e.mass_std_kg):>22}  {moment.true_mass_kg:6,.0f} kg"
            f"  {_grade(e.grade):>8}  {_grade(moment.true_grade):>7}  {_status(moment):<11} {_gate(moment)}",
            flush=True,
        )


def _draw(session: Session) -> None:
    """Draw a live panel on a terminal."""
    from rich.live import Live

    console = terminal.console()
    view = DemoView(session.speed, session.config.estimator.name, console.width)
    with Live(console=console, auto_refresh=False) as live:
        for moment in session.play(1 / REFRESH_HZ):
            live.update(view.picture(moment), refresh=True)


class DemoView:
    """History of the drive, one point per equal share of it."""

    def __init__(self, speed: float, estimator: str, width: int) -> None:
        self._points = max(HISTORY_MIN, min(HISTORY_MAX, width - _FRAME_WIDTH))
        self._title = f"canest demo · a 21 t truck, {speed:g} times real time · estimator {estimator}"
        self._mass = [math.nan] * self._points
        self._grade = [math.nan] * self._points
        self._true_grade = [math.nan] * self._points

    def picture(self, moment: Moment) -> RenderableType:
        """Return the panel for a moment."""
        from rich.panel import Panel
        from rich.table import Table

        from canest.telemetry.broadcast_view import sparkline

        e = moment.estimate
        at = min(int(moment.event_s / moment.duration_s * self._points), self._points - 1)
        self._mass[at], self._grade[at] = e.mass_kg, e.grade
        self._true_grade[at] = moment.true_grade
        grades = [g for g in (*self._grade, *self._true_grade) if not math.isnan(g)]
        low, high = (min(grades), max(grades)) if grades else (0.0, 0.0)
        error = 100 * (e.mass_kg / moment.true_mass_kg - 1)
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="dim", min_width=7)
        grid.add_column(justify="right", min_width=18)
        grid.add_column(style="dim", justify="right", min_width=7)
        grid.add_column(min_width=self._points, no_wrap=True)
        true_mass = f"{moment.true_mass_kg:,.0f} kg"
        off = "" if math.isnan(error) else f"{error:+.1f} %"
        grid.add_row(
            "mass", f"[bold]{_mass(e.mass_kg, e.mass_std_kg)}[/]", off, f"[blue]{sparkline(self._mass)}[/]"
        )
        grid.add_row(" truth", true_mass)
        grid.add_row(
            "grade", f"[bold]{_grade(e.grade)}[/]", "", f"[green]{sparkline(self._grade, low, high)}[/]"
        )
        grid.add_row(
            " truth", _grade(moment.true_grade), "", f"[dim]{sparkline(self._true_grade, low, high)}[/]"
        )
        status = _status(moment)
        gate = _gate(moment)
        learning = f"gate closed: {gate}" if gate else "learning"
        done = int(moment.event_s / moment.duration_s * self._points)
        bar = "━" * done + "[dim]" + "─" * (self._points - done) + "[/]"
        grid.add_row("drive", f"{moment.event_s:.0f} of {moment.duration_s:.0f} s", "", bar)
        received = f"{moment.broadcasts:,} broadcasts received"
        footer = f"[{_COLOURS.get(status, 'cyan')}]{status}[/] · {learning} · {received}"
        return Panel(
            grid, title=self._title, subtitle=footer, title_align="left", subtitle_align="left", expand=False
        )


def _result(session: Session) -> int:
    """Print the final error against the truth."""
    from canest.cli.summary import errors_text

    estimates, score = session.finish()
    if not len(estimates):
        print("the daemon made no estimate")
        return 1
    truth_kg, _ = score.truth_at(estimates.t_us[-1:])
    mass, std = float(estimates.mass_kg[-1]), float(estimates.mass_std_kg[-1])
    off = 100 * (mass / float(truth_kg[0]) - 1)
    print(f"at the end  {_mass(mass, std)}, true {truth_kg[0]:,.0f} kg: {off:+.2f} %")
    print(f"error       {errors_text(score.errors())}")
    settled_s = _settled_s(estimates, score)
    if settled_s is not None:
        print(f"settled     within {SETTLED_PCT:g} % of the true mass after {settled_s:.0f} s of driving")
    print("next        canest check --help, canest replay --help, canest run --help")
    return 0


def _settled_s(estimates: Estimates, score: Score) -> float | None:
    """Return from when on the mass stayed within `SETTLED_PCT` of the truth, None when it never did."""
    import numpy as np

    truth_kg, _ = score.truth_at(estimates.t_us)
    outside = np.flatnonzero(~(np.abs(estimates.mass_kg / truth_kg - 1) <= SETTLED_PCT / 100))
    first = int(outside[-1]) + 1 if len(outside) else 0
    return float(estimates.t_us[first] - estimates.t_us[0]) * 1e-6 if first < len(estimates) else None


def _mass(mass_kg: float, std_kg: float) -> str:
    if math.isnan(mass_kg):
        return "no estimate yet"
    return f"{mass_kg:,.0f} kg" if math.isnan(std_kg) else f"{mass_kg:,.0f} ± {std_kg:,.0f} kg"


def _grade(grade: float) -> str:
    return "-" if math.isnan(grade) else f"{100 * grade:+.2f} %"


def _status(moment: Moment) -> str:
    from canest.core.samples import STATUS_LABELS

    return STATUS_LABELS.get(moment.estimate.status, "waiting")


def _gate(moment: Moment) -> str:
    from canest.core.gates import LABELS

    return LABELS.get(moment.estimate.gate, "")
