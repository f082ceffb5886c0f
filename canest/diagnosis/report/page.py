"""The report of a diagnosis: one sentence, the two sides, then how it was found and what is left."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from canest.diagnosis.entries import Entry
from canest.diagnosis.outcome import dependence, not_tried, reference_limits
from canest.diagnosis.report import figures
from canest.diagnosis.report.figures import BEFORE
from canest.diagnosis.report.format import change, entry_name, entry_value, interval, score_rows
from canest.diagnosis.run import Diagnosis
from canest.diagnosis.sentences import alternatives, capitalised, describe, describe_equivalents
from canest.report.config_section import config_section
from canest.report.figure import BLUE
from canest.report.page import Bar, Card, Page, Section, Table
from canest.vehicle.effects import effect_class

_TONES = {"explained": "good", "partly": "warn", "unexplained": "bad", "nothing-to-explain": "good"}
#: drives whose mass and grade are drawn
DRIVES_SHOWN = 3


def report_page(diagnosis: Diagnosis, found: Sequence[Entry], logs: Sequence[str]) -> Page:
    """Return the page."""
    names = " · ".join(Path(log).name for log in logs[:3]) + (f" + {len(logs) - 3}" if len(logs) > 3 else "")
    page = Page(
        title=f"{names} · {diagnosis.config.vehicle.name} · diagnosis",
        headline=diagnosis.finding,
        facts=_facts(diagnosis),
        cards=_cards(diagnosis),
    )
    page.sections += [_statement(diagnosis), _before_and_after(diagnosis)]
    if diagnosis.steps:
        page.sections.append(_steps(diagnosis))
    if diagnosis.search.chosen:
        page.sections.append(_causes(diagnosis))
    page.sections.append(_over_time(diagnosis))
    page.sections.append(_dependence(diagnosis))
    for drive in range(min(DRIVES_SHOWN, len(diagnosis.problem.parts))):
        page.sections.append(_estimates(diagnosis, drive))
    if found:
        page.sections.append(_candidates(diagnosis, found))
    page.sections.append(_reference(diagnosis))
    page.sections.append(_signals(diagnosis))
    if diagnosis.problem.notes:
        page.sections.append(_notes(diagnosis))
    page.sections.append(config_section(diagnosis.config))
    return page


def _facts(d: Diagnosis) -> list[tuple[str, str]]:
    problem = d.problem
    return [
        ("drives", f"{len(problem.parts)}"),
        ("with open gates", f"{problem.rows:,} s"),
        ("reference", d.references[0].text),
        ("mass", "known" if problem.mass_known else "unknown"),
        ("estimator", d.config.estimator.name),
    ]


def _cards(d: Diagnosis) -> list[Card]:
    b, a = d.before, d.after
    added = ", ".join(c.candidate.effect for c in d.search.chosen) or "nothing"
    cards = [Card("Verdict", d.verdict.replace("-", " "), f"added: {added}", _TONES[d.verdict])]
    pairs: tuple[tuple[str, float | None, float | None, str], ...] = (
        ("Held-out residual RMS", b.residual_rms_N, a.residual_rms_N, "{:,.0f} N"),
        ("Mass error RMS", b.mass_rms_pct, a.mass_rms_pct, "{:.2f} %"),
        ("Grade error RMS", b.grade_rms_deg, a.grade_rms_deg, "{:.3f}°"),
    )
    for label, before, after, form in pairs:
        if before is not None and after is not None:
            note = (
                f"before {form.format(before)}, {change(before, after)}" if d.search.chosen else "unchanged"
            )
            cards.append(Card(label, form.format(after), note, "good" if after < 0.9 * before else ""))
    return cards


def _before_and_after(d: Diagnosis) -> Section:
    text = (
        "Each part of the data is judged with parameters fitted on the other parts"
        + (
            " (whole drives held out)"
            if len(d.problem.parts) > 1
            else " (alternating blocks of the drive held out)"
        )
        + ". In brackets the 95 % confidence interval by block bootstrap."
    )
    rows = [[label, f"{before}  {interval(d.before, key)}", f"{after}  {interval(d.after, key)}"]
            for label, key, before, after in score_rows(d)]  # fmt: skip
    return Section("Before and after", text=text, table=Table(["", "before", "after"], rows))


def _steps(d: Diagnosis) -> Section:
    """Draw how the held-out residual falls from effect to effect."""
    first = max(d.before.residual_rms_N, 1e-9)
    left = [("the model as configured", d.before.residual_rms_N, BEFORE)]
    for step in d.steps:
        same = "".join(f" or {effect_class(n).in_words()}" for n in alternatives(step.added))
        left.append((f"with {describe(step.added)}{same}", step.residual_rms_N, BLUE))
    bars = [Bar(label, min(n / first, 1.0), colour, f"{n:,.0f} N") for label, n, colour in left]
    text = (
        "RMS of the held-out residual: what the model leaves unexplained, and what is left of it after each "
        "effect that was added. Every step keeps those before it."
    )
    if len(d.search.rivals) > 1 and d.search.chosen:
        text += " Other sets of effects do as well, see the lines above."
    return Section("What explains it", text=text, bars=bars)


def _statement(d: Diagnosis) -> Section:
    return Section("In numbers", table=Table([""], [[line] for line in d.details]))


def _causes(d: Diagnosis) -> Section:
    text = (
        "Each added effect against its cause: the residual without it (the others in place) and with it. "
        "Lines are means with two standard errors. An effect that is right leaves a flat line at zero."
    )
    return Section("Residual against its cause", text=text, figure=figures.against_causes(d))


def _over_time(d: Diagnosis) -> Section:
    text = "One point per second with open gates; the line is a mean over seven. " + _hidden_part(d)
    return Section("Residual over time", text=text, figure=figures.over_time(d))


def _hidden_part(d: Diagnosis) -> str:
    if all(p.reference.sin_beta_std == 0.0 for p in d.problem.parts):
        return ""
    return "The grade is not known exactly: what changes as slowly as a road may is filtered out here."


def _notes(d: Diagnosis) -> Section:
    noted = (f"{Path(log).name}: {'; '.join(notes)}" for log, notes in d.problem.notes.items())
    return Section("Notes", text=" · ".join(noted))


def _dependence(d: Diagnosis) -> Section:
    rows = [
        [name, f"{100 * shares['before']:.0f} %", f"{100 * shares['after']:.0f} %"]
        for name, shares in dependence(d).items()
    ]
    size = 100 * d.after.residual_rms_N / d.problem.weight_N
    text = (
        f"What is left: {d.after.residual_rms_N:,.0f} N RMS, {size:.2f} % of the weight (as much as a slope "
        f"of {size:.2f} %). The table has which share of the residual a curve over each quantity would "
        "explain; near zero is what noise looks like. " + _hidden_part(d)
    )
    table = Table(["residual explained by", "before", "after"], rows)
    return Section(
        "What the residual depends on", text=text, figure=figures.against_everything(d), table=table
    )


def _estimates(d: Diagnosis, drive: int) -> Section:
    name = d.problem.parts[drive].drive.name
    rest = len(d.problem.parts) - DRIVES_SHOWN
    more = f" ({rest} more drives are not drawn)" if rest > 0 and drive == 0 else ""
    text = f"The estimator {d.config.estimator.name} on {name}, bands are two standard deviations{more}."
    figure = figures.mass_and_grade(d, drive)
    return Section(f"Mass and grade: {name}", text=text, figure=figure)


def _candidates(d: Diagnosis, found: Sequence[Entry]) -> Section:
    rows = [
        [
            ("● " if e.selected else "") + entry_name(e),
            entry_value(e),
            f"{100 * e.explained:.1f} %",
            f"{100 * e.score:.1f} %",
            ", ".join(e.equivalent) or "-",
        ]
        for e in found
    ]
    rows += [[name, "not tried", "", "", reason] for name, reason in not_tried(d, found).items()]
    alike = [f"{capitalised(describe(c))}: {describe_equivalents(c)}." for c in d.search.chosen
             if describe_equivalents(c)]  # fmt: skip
    text = (
        "Values of the selected effects (●) are fitted together, of their equivalents in their place, of all "
        "others alone. The model column is what the best model with the effect in it removes. "
        + " ".join(alike)
    )
    header = ["effect", "value ± standard deviation", "removes", "model", "inseparable from"]
    return Section("Every effect tried", text=text, table=Table(header, rows, left=(0, 4)))


def _reference(d: Diagnosis) -> Section:
    rows = [
        [p.drive.name, p.reference.text,
         "-" if p.reference.mass_kg is None else f"{p.mass_kg.mean():,.0f} kg",
         f"{100 * p.reference.sin_beta_std:.2f} %", f"{p.windows.count:,} s"]
        for p in d.problem.parts
    ]  # fmt: skip
    header = ["drive", "grade", "known mass", "error of the grade (1 σ)", "open"]
    return Section(
        "Measured against", text=reference_limits(d.references), table=Table(header, rows, left=(0, 1))
    )


def _signals(d: Diagnosis) -> Section:
    title = "Signals of the bus that the model does not use"
    if not d.ranked:
        if d.verdict == "nothing-to-explain" or not d.search.candidates:
            return Section(title, text="Not ranked: nothing is left to explain.")
        return Section(title, text="Not ranked, or none explains a hundredth of what is left.")
    rows = [[r.name, f"{100 * r.explained:.1f} %", "yes" if r.switches else ""] for r in d.ranked]
    text = "By how much of the remainder they explain out of sample. Coincidence can do a few per cent."
    return Section(title, text=text, table=Table(["signal", "explains", "goes on and off"], rows))
