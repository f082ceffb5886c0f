"""The whole diagnosis, from logs to files: residual, tracing, adding, before and after."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from canest.config.schema import Config, Source
from canest.core.errors import LogError, UsageError
from canest.core.frames import FloatColumn
from canest.core.roles import ROLES
from canest.diagnosis.data.drive import Drive, NothingToDiagnoseError
from canest.diagnosis.data.least_squares import FOLDS
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.data.reference import Reference, reference_for
from canest.diagnosis.data.residual_windows import CHUNK_S
from canest.diagnosis.report.sentences import finding_of, too_short
from canest.diagnosis.search.bus_signals import Ranked, rank_bus_signals
from canest.diagnosis.search.candidates import Candidate, candidates_for, switching_roles
from canest.diagnosis.search.choice import Tried
from canest.diagnosis.search.forward_selection import MIN_TORQUE_STEPS, Search
from canest.diagnosis.search.gauss_newton import fit_on
from canest.diagnosis.search.held_out import Fold, Score, score, two_folds
from canest.logs.memory import MemoryLog
from canest.pipeline.build import effects_of
from canest.pipeline.pipeline import Estimates

#: what is left may wander this much (share of weight) and still count as explained: a slope of 0.04 %
SMALL_REMAINDER = 4e-4
#: shares of the first residual's variance that make a verdict
EXPLAINED_SHARE, PARTLY_SHARE = 0.95, 0.2
#: roles of the signal map that may switch a load and that the model does not use otherwise
SWITCH_ROLES = ("fan_speed", "pto_state")
#: a bus signal must explain this much of the remainder to be tried as a switch
TRY_SIGNAL_SHARE = 0.1

#: so many blocks of open driving make a held-out score and its standard error; fewer are an anecdote
MIN_CHUNKS = FOLDS

Tell = Callable[[str, float], None]


@dataclass
class Diagnosis:
    """Everything found, for the JSON, the revised config and the report."""

    config: Config
    problem: Problem
    search: Search
    tried: list[Tried]
    before: Score
    after: Score
    residual_before_N: FloatColumn
    residual_after_N: FloatColumn
    estimates_before: list[Estimates]
    estimates_after: list[Estimates]
    verdict: str
    finding: str
    ranked: list[Ranked]
    references: list[Reference]


def diagnose(
    paths: Sequence[Path | MemoryLog],
    config: Config,
    *,
    truths: Sequence[Path | MemoryLog | None] | None = None,
    mass_kg: float | None = None,
    channel: str | None = None,
    tell: Tell = lambda _text, _share: None,
) -> Diagnosis:
    """Diagnose one drive, or several of one vehicle together.

    truths: a truth file per log, or None; mass_kg: known mass of all. channel: this interface of the logs
    only. tell: progress (text, share done).
    Errors: LogError for logs with too little open driving, UsageError for no log.
    """
    if not paths:
        raise UsageError("no log to diagnose")
    tell("reading", 0.0)
    problem, references = _problem(paths, config, truths, mass_kg, channel, tell)
    if problem.chunks < MIN_CHUNKS:
        return _too_short(config, problem, references)
    search, tried = _search(problem, config, SWITCH_ROLES, tell)
    ranked: list[Ranked] = []
    if not _little_left(problem, search):
        tell("ranking every signal on the bus", 0.6)
        ranked = rank_bus_signals(config, problem, search)
        extended = _with_switches(config, ranked)
        if extended is not config:
            again, references_again = _problem(paths, extended, truths, mass_kg, channel, tell)
            new = [r for r in extended.signals if r not in config.signals]
            search_again, tried_again = _search(again, extended, [*SWITCH_ROLES, *new], tell)
            if any(dict(c.candidate.shape).get("signal") in new for c in search_again.chosen):
                problem, search, tried = again, search_again, tried_again
                references, config = references_again, extended
    tell("before and after", 0.8)
    nothing = np.zeros(problem.rows)
    whole = np.ones(problem.rows, np.bool_)
    if problem.mass_known:
        before_folds = [Fold(search.base, nothing, whole)]
    else:
        before_folds = two_folds(problem, search.without_choice())
    before, left_before, shown_before = score(problem, before_folds)
    after, left_after, shown_after = before, left_before, shown_before
    if search.chosen:
        after, left_after, shown_after = score(problem, two_folds(problem, search))
        if after.residual_rms_N >= before.residual_rms_N:
            # fitted on one half it makes the other worse: whatever it is, it must not go into a config
            search = search.without_choice()
            after, left_after, shown_after = before, left_before, shown_before
    verdict = _verdict(problem, search, before, after)
    hints = [r.name for r in ranked[:1] if r.explained > TRY_SIGNAL_SHARE]
    hidden_N = search.hidden_N() if search.all_hidden(tried) else None
    finding = finding_of(verdict, search.chosen, before.residual_rms_N, after.residual_rms_N, hints, hidden_N)
    tell("done", 1.0)
    return Diagnosis(
        config, problem, search, tried, before, after, left_before, left_after, shown_before, shown_after,
        verdict, finding, ranked, references,
    )  # fmt: skip


def _too_short(config: Config, problem: Problem, references: list[Reference]) -> Diagnosis:
    """Return the residual of a log that is too short for more."""
    search = Search(problem, effects_of(config), [])
    now, left, shown = score(problem, two_folds(problem, search))
    finding = too_short(problem.rows, MIN_CHUNKS * CHUNK_S, now.residual_rms_N)
    return Diagnosis(
        config, problem, search, [], now, now, left, left, shown, shown,
        "nothing-to-explain", finding, [], references,
    )  # fmt: skip


def _problem(
    paths: Sequence[Path | MemoryLog],
    config: Config,
    truths: Sequence[Path | MemoryLog | None] | None,
    mass_kg: float | None,
    channel: str | None,
    tell: Tell,
) -> tuple[Problem, list[Reference]]:
    base = effects_of(config)
    drives, failed, useless = [], [], []
    for i, path in enumerate(paths):
        tell(f"reading {path.name}", 0.3 * i / len(paths))
        try:
            drive = Drive.load(path, config, channel)
            run = drive.run(base)
            reference = reference_for(drive, run, truth=truths[i] if truths else None, mass_kg=mass_kg)
        except NothingToDiagnoseError as error:
            useless.append(str(error))
            continue
        except LogError as error:
            failed.append(str(error))
            continue
        drives.append((drive, reference, run))
    if not drives:
        raise LogError("; ".join(failed + useless))
    problem = Problem(drives, failed)
    problem.left_out += useless
    return problem, [p.reference for p in problem.parts]


def _search(
    problem: Problem, config: Config, switches: Sequence[str], tell: Tell
) -> tuple[Search, list[Tried]]:
    present = switching_roles(problem, [r for r in switches if r in config.signals])
    candidates: list[Candidate] = candidates_for(problem, present)
    base = effects_of(config)
    done = 0

    def tick(label: str) -> None:
        nonlocal done
        done += 1
        tell(f"trying {label}", 0.3 + 0.25 * min(1.0, done / len(candidates)))

    search = Search(problem, base, candidates, tick)
    tried = search.alone()
    search.run()
    return search, tried


def _with_switches(config: Config, ranked: Sequence[Ranked]) -> Config:
    """Return the config with the best-ranked switching signals in its map (unchanged when there is none)."""
    new: dict[str, Source] = {}
    for r in ranked[:5]:
        if r.switches and r.explained > TRY_SIGNAL_SHARE:
            new[_role_for(r.source, {*ROLES, *config.signals, *new})] = r.source
    if not new:
        return config
    return config.model_copy(update={"signals": config.signals | new})


def _role_for(source: Source, taken: Collection[str]) -> str:
    """Return a name for what a signal says: never a role that means something else to the model already."""
    name = (source.signal or source.column or "").lower()
    role = re.sub(r"\W+", "_", name).strip("_") or "signal"
    while role in taken:
        role = f"other_{role}"
    return role


def _remainder_N(problem: Problem, search: Search) -> float:
    """Return how much the remainder wanders from chunk to chunk, in N: noise averages out, causes do not."""
    left = search.residual_N + _mass_part(problem, search)
    sums = np.bincount(problem.chunk, weights=left)
    counts = np.maximum(np.bincount(problem.chunk), 1)
    means = sums / counts
    noise = left.var() / counts
    return float(np.sqrt(max(np.mean(means**2 - noise), 0.0)))


def _little_left(problem: Problem, search: Search) -> bool:
    """Return whether the remainder wanders by no more than a small slope, or the rounding of torque, does."""
    rounding_N = MIN_TORQUE_STEPS * problem.torque_step_N
    return _remainder_N(problem, search) < max(SMALL_REMAINDER * problem.weight_N, rounding_N)


def _mass_part(problem: Problem, search: Search) -> FloatColumn:
    if problem.mass_known:
        return np.zeros(problem.rows)
    _, taken = fit_on(problem, search.base, search.chosen, np.ones(problem.rows, np.bool_))
    return -taken


def _verdict(problem: Problem, search: Search, before: Score, after: Score) -> str:
    small = _little_left(problem, search)
    if not search.chosen:
        return "nothing-to-explain" if small else "unexplained"
    explained = 1.0 - (after.residual_rms_N / max(before.residual_rms_N, 1e-9)) ** 2
    if small or explained >= EXPLAINED_SHARE:
        return "explained"
    return "partly" if explained >= PARTLY_SHARE else "unexplained"


def revised(diagnosis: Diagnosis) -> Config:
    """Return the config with the selected effects in its list, values rounded to what is known of them."""
    base = list(diagnosis.config.effects)
    added = []
    for chosen in diagnosis.search.chosen:
        entry = chosen.effect().to_config()
        digits = max(0, 2 - int(np.floor(np.log10(max(chosen.std, 1e-12)))))
        entry[chosen.candidate.parameter] = round(float(entry[chosen.candidate.parameter]), digits)
        added.append(entry)
    return diagnosis.config.model_copy(update={"effects": (*base, *added)})
