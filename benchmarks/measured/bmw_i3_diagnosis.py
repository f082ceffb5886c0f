"""What the model lacks on trips of an electric car: found on half of the trips, judged on the other half."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from common import Page, middle_half_pct, number

from canest.config import Config
from canest.core import jit
from canest.diagnosis.data.drive import Drive
from canest.diagnosis.data.problem import MIN_WINDOWS, Problem
from canest.diagnosis.data.reference import reference_for
from canest.diagnosis.entries import entries
from canest.diagnosis.outcome import reference_limits
from canest.diagnosis.report.format import entry_name, entry_value, interval, score_rows
from canest.diagnosis.report.revised_config import revised_config
from canest.diagnosis.run import Diagnosis, diagnose
from canest.diagnosis.search.value_fit import fit_on
from canest.logs.table_in_memory import TableLog
from canest.pipeline.build import effects_of
from canest.vehicle.effects import Effect

Sides = tuple[list[Effect], list[Effect]]


class Held(NamedTuple):
    """One held-out trip, without and with what was found: residual RMS in N, mass in kg.

    filtered_N: the residual after what may be an error of the reference's grade is filtered out.
    """

    name: str
    open_s: int
    residual_N: tuple[float, float]
    filtered_N: tuple[float, float]
    mass_kg: tuple[float, float]


def judge(name: str, log: TableLog, config: Config, sides: Sides) -> Held | None:
    """Run both models on a trip; None where the gates are hardly ever open."""
    drive = Drive.load(log, config)
    plain = drive.run(sides[0])
    try:
        problem = Problem([(drive, reference_for(drive, plain), plain)])
    except Exception as error:
        print(f"{name}: {error}", file=sys.stderr)
        return None
    residuals, filtered, masses = [], [], []
    for effects in sides:
        # the mass is free on every trip and with either model, as it is for the estimator
        _, taken = fit_on(problem, effects, [], np.ones(problem.rows, np.bool_))
        left = problem.residual_N(effects) - taken
        residuals.append(float(np.sqrt((left**2).mean())))
        filtered.append(float(np.sqrt((problem.whiten(left) ** 2).mean())) * problem.unit_N)
        mass = drive.estimate(effects).mass_kg
        known = mass[np.isfinite(mass)]
        masses.append(float(known[-1]) if len(known) else float("nan"))
    pairs = [(before, after) for before, after in (residuals, filtered, masses)]
    return Held(name, problem.rows, *pairs)


def pooled_rows(trips: list[Held], field: str, label: str) -> list[tuple[str, str, str]]:
    """Return table rows: RMS over all seconds, its change with a 95 % interval (whole trips drawn anew)."""
    weight = np.array([t.open_s for t in trips], float)
    square = np.array([getattr(t, field) for t in trips]) ** 2 * weight[:, None]
    before, after = np.sqrt(square.sum(axis=0) / weight.sum())
    draws = np.random.default_rng(0).integers(0, len(trips), (2000, len(trips)))
    sums = square[draws].sum(axis=1)
    low, high = 100 * (np.percentile(np.sqrt(sums[:, 1] / sums[:, 0]), [2.5, 97.5]) - 1)
    fell = int((square[:, 1] < square[:, 0]).sum())
    return [
        (label, f"{before:.1f} N", f"{after:.1f} N"),
        (
            "its change, 95 % interval",
            "",
            f"{100 * (after / before - 1):+.1f} % [{low:+.1f} … {high:+.1f} %]",
        ),
        ("trips in which it fell", "", f"{fell} of {len(trips)}"),
    ]


def write_found(page: Page, d: Diagnosis, wall_s: float, judged: int) -> None:
    """Write what was found on the trips that were diagnosed."""
    page.section("What the model lacks")
    page.text(
        f"`canest diagnose` on every second trip by name ({len(d.problem.parts)} trips, {d.problem.rows:,} s "
        f"with open gates, {wall_s:.0f} s of computing); the other {judged} are judged. There is no truth: "
        f"the reference is {d.references[0].text}; the mass is free on every trip."
    )
    page.text(f"**{d.finding}** Verdict: {d.verdict}.")
    page.text(reference_limits(d.references))
    rows = []
    for e in entries(d)[:10]:
        name = f"**{entry_name(e)}**" if e.selected else entry_name(e)
        rows.append((name, entry_value(e), f"{100 * e.explained:.1f} %", ", ".join(e.equivalent) or "-"))
    page.table(("effect", "value ± std", "removes", "cannot be separated from"), rows)
    page.text("Bold: added to the model. On the diagnosed trips, whole trips held out:")
    scores = [
        (label, f"{b} {interval(d.before, key)}", f"{a} {interval(d.after, key)}")
        for label, key, b, a in score_rows(d)
    ]
    page.table(("", "before", "after"), scores)


def write_judged(page: Page, trips: list[Held]) -> None:
    """Write what the revised model does to trips that took no part."""
    page.section(f"On the {len(trips)} trips that took no part")
    page.text(
        "Nothing is fitted here but the mass of each trip, which is free with either model. The second "
        "residual leaves out what may be an error of the reference's grade. Temperature joined the effects "
        "that are tried after earlier versions had been judged on these same trips, which showed summer and "
        "winter apart: its coefficient is fitted without them, the idea is not, so the intervals flatter it."
    )
    before, after = ([t.mass_kg[side] for t in trips] for side in (0, 1))
    std = [100 * statistics.stdev(m) / statistics.median(m) for m in (before, after)]
    page.table(
        ("", "before", "after"),
        [
            *pooled_rows(trips, "residual_N", "residual RMS"),
            *pooled_rows(trips, "filtered_N", "residual RMS, grade errors filtered out"),
            ("estimated mass, median", *(number(statistics.median(m), 0, " kg") for m in (before, after))),
            ("its spread over trips, standard deviation", *(number(s, 2, " %") for s in std)),
            ("its middle half", *(number(middle_half_pct(m), 2, " %") for m in (before, after))),
        ],
    )


def _show(text: str, done: float) -> None:
    print(
        f"\rdiagnosis: {100 * done:3.0f} % {text:50}",
        end="",
        file=sys.stderr,
        flush=True,
    )


def write_diagnosis(page: Page, tables: Mapping[str, Any], config: Config) -> None:
    """Diagnose every second trip, judge the others, and write both."""
    if len(tables) < 4:
        page.section("What the model lacks")
        page.text("Too few trips to find it on half of them and judge it on the other half.")
        return
    jit.enable()
    logs = {name: TableLog(table, name) for name, table in tables.items()}
    names = list(logs)
    begin = time.monotonic()
    d = diagnose([logs[n] for n in names[0::2]], config, progress=_show)
    wall_s = time.monotonic() - begin
    base = effects_of(config)
    sides = (list(base), list(effects_of(revised_config(d))))
    held = [t for n in names[1::2] if (t := judge(n, logs[n], config, sides)) and t.open_s >= MIN_WINDOWS]
    write_found(page, d, wall_s, len(held))
    write_judged(page, held)
