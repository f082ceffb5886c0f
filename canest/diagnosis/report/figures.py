"""The figures of a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from canest.core.estimates import Estimates
from canest.core.frames import FloatColumn, MonotonicClock
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.run import Diagnosis
from canest.diagnosis.search.choice import Chosen
from canest.diagnosis.search.dependence import Cause, binned, cause_of, causes
from canest.report.figure import BLUE, GREEN, INK, MUTED, ORANGE, Rows, Stroke, numbers
from canest.report.panels import Panels

BEFORE, AFTER = ORANGE, BLUE
#: points of a cloud or a curve
POINTS_MAX = 3_000
#: a pause of the open gates this long breaks a curve, s
BREAK_S = 3.0
_SMOOTH = 7  #: windows of the moving average in the figure over time


def visible(problem: Problem, residual_N: FloatColumn) -> FloatColumn:
    """Return what of a residual (n,) the reference lets see, N: an unknown slow grade is filtered out."""
    return problem.whiten(residual_N) * problem.unit_N


def over_time(diagnosis: Diagnosis) -> str:
    """Residual before and after over the time of all drives, one behind the other."""
    problem = diagnosis.problem
    t = np.empty(problem.rows)
    start, offset = 0, 0.0
    for part in problem.parts:
        n = part.windows.count
        t[start : start + n] = part.windows.t_s + offset
        start, offset = start + n, float(t[start + n - 1]) + 30.0
    rows = Rows(["residual, N"], [2.2], "seconds" + (" (drives in a row)" if len(problem.parts) > 1 else ""))
    for name, column, colour in (
        ("before", diagnosis.residual_before_N, BEFORE),
        ("after", diagnosis.residual_after_N, AFTER),
    ):
        if name == "after" and not diagnosis.search.chosen:
            continue
        seen = visible(problem, column)
        keep = _thinned(len(t))
        rows.traces.append({
            "type": "scatter", "mode": "markers", "x": numbers(t[keep], 1), "y": numbers(seen[keep], 0),
            "marker": {"size": 3, "color": colour, "opacity": 0.35}, "showlegend": False,
            "legendgroup": name, "hoverinfo": "skip", "xaxis": "x", "yaxis": "y",
        })  # fmt: skip
        x, y = _broken(t, _smoothed(seen))
        rows.line(1, numbers(x, 1), numbers(y, 0), name, Stroke(colour, width=2.0), hover="%{y:.0f} N")
    rows.axis(1)["zeroline"] = True
    return rows.to_json()


def against_causes(diagnosis: Diagnosis) -> str:
    """Each selected effect against its own cause: residual without it (the others in) and with it."""
    problem, search = diagnosis.problem, diagnosis.search
    everything = np.ones(problem.rows, np.bool_)
    taken = 0.0 if problem.mass_known else search.fit_on(everything)[1]
    after = search.residual_N
    shown: list[tuple[Chosen, Cause, FloatColumn]] = []
    for chosen in search.chosen:
        rest = [c.effect() for c in search.chosen if c is not chosen]
        without = problem.residual_N([*search.base, *rest])
        shown.append((chosen, cause_of(problem, chosen, without - after), without))
    panels = Panels([cause.label for _, cause, _ in shown], "residual, N", columns=min(3, len(shown)))
    for i, (chosen, cause, without) in enumerate(shown):
        panels.axis(i, "x")["title"]["text"] = f"{chosen.candidate.effect}: {cause.label}"
        for name, column, colour in (("without the effect", without, BEFORE), ("with it", after, AFTER)):
            _panel(panels, i, problem, cause.values, visible(problem, column - taken), name, colour)
    return panels.to_json()


def against_everything(diagnosis: Diagnosis) -> str:
    """Residual before and after against speed, torque, gear and so on."""
    problem = diagnosis.problem
    found = causes(problem)
    panels = Panels([c.label for c in found.values()], "residual, N")
    sides = [("before", diagnosis.residual_before_N, BEFORE), ("after", diagnosis.residual_after_N, AFTER)]
    for name, column, colour in sides if diagnosis.search.chosen else sides[:1]:
        seen = visible(problem, column)
        for i, cause in enumerate(found.values()):
            _panel(panels, i, problem, cause.values, seen, name, colour)
    return panels.to_json()


def mass_and_grade(diagnosis: Diagnosis, drive: int) -> str:
    """The estimator's mass and grade before and after on one drive, with the truth where it is known."""
    part = diagnosis.problem.parts[drive]
    rows = Rows(["mass, t", "grade, %"], [1.6, 1.6], "seconds since the start")
    sides: list[tuple[str, Sequence[Estimates], str]] = [("before", diagnosis.estimates_before, BEFORE)]
    if diagnosis.search.chosen:
        sides.append(("after", diagnosis.estimates_after, AFTER))
    t_us = MonotonicClock()(part.run.samples.t_us)
    keep = _thinned(len(t_us))
    # what the samples show was a while before their stamps
    x = numbers((t_us[keep] - t_us[0]) * 1e-6 - part.run.behind_s, 1)
    reference = part.reference
    settled: list[FloatColumn] = []
    for name, estimates, colour in sides:
        e = estimates[drive]
        t = numbers((MonotonicClock()(e.t_us)[_thinned(len(e))] - t_us[0]) * 1e-6, 1)
        mass, std = e.mass_kg[_thinned(len(e))] / 1e3, e.mass_std_kg[_thinned(len(e))] / 1e3
        rows.band(1, t, numbers(mass - 2 * std, 3), numbers(mass + 2 * std, 3), colour, name)
        rows.line(1, t, numbers(mass, 3), name, Stroke(colour), hover="%{y:.2f} t")
        grade = 100 * e.grade[_thinned(len(e))]
        rows.line(2, t, numbers(grade, 3), name, Stroke(colour, width=1.2), hover="%{y:.2f} %", legend=False)
        late = slice(len(mass) // 2, None)
        settled += [(mass - 2 * std)[late], (mass + 2 * std)[late]]
    if reference.mass_kg is not None:
        settled.append(reference.mass_kg[keep] / 1e3)
        rows.line(
            1,
            x,
            numbers(reference.mass_kg[keep] / 1e3, 3),
            "known mass",
            Stroke(INK, dash="dash"),
            hover="%{y:.2f} t",
        )
    if reference.grade is not None:
        rows.line(
            2,
            x,
            numbers(100 * reference.grade[keep], 3),
            "known grade",
            Stroke(INK, width=1.2, dash="dash"),
            hover="%{y:.2f} %",
        )
    elif reference.kind != "none":
        rows.line(
            2,
            x,
            numbers(100 * reference.sin_beta[keep], 3),
            "reference grade",
            Stroke(GREEN, width=1.2, dash="dot"),
            hover="%{y:.2f} %",
        )
    _fit(rows, settled)
    return rows.to_json()


def _fit(rows: Rows, masses: list[FloatColumn]) -> None:
    """Show the settled masses, not the start of the estimator."""
    known = np.concatenate([m[np.isfinite(m)] for m in masses])
    if len(known):
        low, high = np.percentile(known, (1, 99))
        room = max(0.4 * (high - low), 0.03 * high)
        rows.axis(1)["range"] = [float(low - room), float(high + room)]


def _panel(
    panels: Panels,
    i: int,
    problem: Problem,
    x: FloatColumn,
    y: FloatColumn,
    name: str,
    colour: str,
) -> None:
    keep = _thinned(len(x))
    panels.points(i, x[keep], y[keep], name, colour if colour != BEFORE else MUTED, cloud=True)
    means = binned(x, y, problem.chunk)
    panels.points(i, means.centre, means.mean, name, colour, spread=means.std)
    # the clouds' outliers would hide the means
    size = np.abs(y[np.isfinite(y)])
    limit = 1.5 * float(np.percentile(size, 97)) if len(size) else 1.0
    before = panels.axis(i, "y").get("range", [0.0, 0.0])[1]
    panels.axis(i, "y")["range"] = [-max(limit, before), max(limit, before)]


def _thinned(n: int) -> slice:
    return slice(None, None, max(1, -(-n // POINTS_MAX)))


def _smoothed(y: FloatColumn) -> FloatColumn:
    kernel = np.ones(_SMOOTH)
    return np.convolve(y, kernel, "same") / np.convolve(np.ones(len(y)), kernel, "same")


def _broken(t: FloatColumn, y: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
    """Break a curve where the gates were closed."""
    at = np.flatnonzero(np.diff(t) > BREAK_S) + 1
    return np.insert(t, at, t[at - 1]), np.insert(y, at, np.nan)
