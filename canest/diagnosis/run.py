"""The whole diagnosis, from logs to files: residual, tracing, adding, before and after."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from canest.config.schema import Config
from canest.core.errors import LogError, UsageError
from canest.core.estimates import Estimates
from canest.core.frames import FloatColumn
from canest.core.samples import Status
from canest.diagnosis.data.drive import Drive, NothingToDiagnoseError
from canest.diagnosis.data.least_squares import FOLDS
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.data.reference import Reference, reference_for
from canest.diagnosis.data.residual_windows import CHUNK_S
from canest.diagnosis.search.bus_signals import Ranked, rank_bus_signals
from canest.diagnosis.search.candidates import candidates_for
from canest.diagnosis.search.choice import Chosen, Tried
from canest.diagnosis.search.exclusion import not_excluded
from canest.diagnosis.search.held_out import Fold, Score, Step, score, steps_to, two_folds
from canest.diagnosis.search.set_search import Search
from canest.diagnosis.search.switches import SWITCH_ROLES, TRY_SIGNAL_SHARE, switching_roles, with_switches
from canest.diagnosis.sentences import (
    Context,
    Statement,
    far_from_given_mass,
    load_against_constant_mass,
    statement_of,
    too_short_statement,
)
from canest.diagnosis.verdict import grade_part_N, little_left, verdict_of, within_usual
from canest.logs.memory import MemoryLog
from canest.pipeline.build import effects_of

#: so many blocks of open driving make a held-out score and its standard error; fewer are an anecdote
MIN_CHUNKS = FOLDS
#: an estimate so many std, and so much of the mass, away from the given mass is a reason to doubt that
_FAR_STDS, _FAR_PCT = 4.0, 8.0

#: called with what is being done and the share that is done
Progress = Callable[[str, float], None]


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
    details: tuple[str, ...]
    ranked: list[Ranked]
    steps: list[Step]
    references: list[Reference]
    #: effects that this data does not rule out in the size of an ordinary fault
    not_excluded: list[str]


def diagnose(
    paths: Sequence[Path | MemoryLog],
    config: Config,
    *,
    truths: Sequence[Path | MemoryLog | None] | None = None,
    mass_kg: float | None = None,
    channel: str | None = None,
    progress: Progress = lambda _text, _share: None,
) -> Diagnosis:
    """Diagnose one drive, or several of one vehicle together.

    truths: a truth file per log, or None; mass_kg: known mass of all. channel: this interface of the logs
    only. progress: called with a text and the share done.
    Errors: LogError for logs with too little open driving, UsageError for no log.
    """
    if not paths:
        raise UsageError("no log to diagnose")
    progress("reading", 0.0)
    data = _Data(paths, truths, mass_kg, channel, progress)
    problem = data.problem(config)
    if problem.chunks < MIN_CHUNKS:
        return _too_short(config, problem)
    search, tried = _search(problem, config, SWITCH_ROLES, progress)
    ranked: list[Ranked] = []
    if not little_left(problem, search):
        progress("ranking every signal on the bus", 0.6)
        ranked = rank_bus_signals(config, problem, search)
        config, search, tried = _with_bus_switches(data, config, ranked, (search, tried))
        problem = search.problem
    progress("before and after", 0.8)
    before, after, search = _before_and_after(search)
    hints = [r.name for r in ranked if r.explained > TRY_SIGNAL_SHARE and not r.repeats][:1]
    verdict = verdict_of(problem, search, before.score, after.score)
    possible = not_excluded(search)
    context = Context(
        rivals=search.rivals,
        hints=hints,
        hidden_N=search.hidden_N() if search.all_hidden(tried) else None,
        grade_N=grade_part_N(problem),
        delay=search.usual_delay,
        usual=within_usual(problem, search),
        not_excluded=possible,
    )
    sizes_N = before.score.residual_rms_N, after.score.residual_rms_N
    statement = statement_of(verdict, search.chosen, *sizes_N, context)
    doubts = _other_mass(before, problem) + _changed_load(problem, search.chosen)
    statement = replace(statement, details=doubts + statement.details)
    progress("done", 1.0)
    return _diagnosis(config, search, tried, ranked, (before, after), (verdict, statement), possible)


@dataclass(frozen=True)
class _Side:
    """The model on one side of the table: its score, its residual (n,) and one drive's estimates each."""

    score: Score
    residual_N: FloatColumn
    estimates: list[Estimates]


def _other_mass(before: _Side, problem: Problem) -> tuple[str, ...]:
    """Return that the estimate is far from the given mass, which may be wrong itself."""
    error_pct = before.score.mass_error_pct
    stds_pct = [
        100.0 * float(np.median((e.mass_std_kg / e.mass_kg)[e.status == Status.VALID]))
        for e in before.estimates
        if (e.status == Status.VALID).any()
    ]
    if not problem.mass_known or error_pct is None or not stds_pct:
        return ()
    std_pct = max(stds_pct)
    if abs(error_pct) <= max(_FAR_STDS * std_pct, _FAR_PCT):
        return ()
    return (far_from_given_mass(error_pct, _FAR_STDS),)


def _changed_load(problem: Problem, chosen: Sequence[Chosen]) -> tuple[str, ...]:
    """Return that a load changed where the given mass does not."""
    if not problem.mass_known or all(c.candidate.kind.stage != "load" for c in chosen):
        return ()
    masses = [p.reference.mass_kg for p in problem.parts if p.reference.mass_kg is not None]
    if any(np.nanmin(mass) != np.nanmax(mass) for mass in masses):
        return ()
    return (load_against_constant_mass(),)


def _diagnosis(
    config: Config,
    search: Search,
    tried: list[Tried],
    ranked: list[Ranked],
    sides: tuple[_Side, _Side],
    outcome: tuple[str, Statement],
    possible: Sequence[str] = (),
) -> Diagnosis:
    """Return the whole. sides: before and after; outcome: verdict and statement; possible: not excluded."""
    before, after = sides
    return Diagnosis(
        config=config,
        problem=search.problem,
        search=search,
        tried=tried,
        before=before.score,
        after=after.score,
        residual_before_N=before.residual_N,
        residual_after_N=after.residual_N,
        estimates_before=before.estimates,
        estimates_after=after.estimates,
        verdict=outcome[0],
        finding=outcome[1].finding,
        details=outcome[1].details,
        ranked=ranked,
        steps=steps_to(search, after.score.residual_rms_N),
        references=[p.reference for p in search.problem.parts],
        not_excluded=list(possible),
    )


def _with_bus_switches(
    data: _Data, config: Config, ranked: Sequence[Ranked], first: tuple[Search, list[Tried]]
) -> tuple[Config, Search, list[Tried]]:
    """Search again with the best-ranked switching signals as roles; keep that where one of them is chosen."""
    extended = with_switches(config, ranked)
    if extended is not config:
        new = [r for r in extended.signals if r not in config.signals]
        again = _search(data.problem(extended), extended, [*SWITCH_ROLES, *new], data.progress)
        if any(dict(c.candidate.shape).get("signal") in new for c in again[0].chosen):
            return extended, *again
    return config, *first


def _before_and_after(search: Search) -> tuple[_Side, _Side, Search]:
    """Return both sides, and the search with nothing chosen where that is no better on held-out data."""
    problem = search.problem
    if not problem.nuisance.shape[1]:
        folds = [Fold(search.base, np.zeros(problem.rows), np.ones(problem.rows, np.bool_))]
    else:
        folds = two_folds(problem, search.without_choice())
    before = _Side(*score(problem, folds))
    if not search.chosen:
        return before, before, search
    after = _Side(*score(problem, two_folds(problem, search)))
    if after.score.residual_rms_N >= before.score.residual_rms_N:
        # fitted on one half it makes the other worse: whatever it is, it must not go into a config
        bare = search.without_choice()
        bare.rivals = search.rivals  # which are as likely is still worth a word
        return before, before, bare
    return before, after, search


def _too_short(config: Config, problem: Problem) -> Diagnosis:
    """Return the residual of a log that is too short for more."""
    search = Search(problem, effects_of(config), [])
    now = _Side(*score(problem, two_folds(problem, search)))
    statement = too_short_statement(problem.rows, MIN_CHUNKS * CHUNK_S, now.score.residual_rms_N)
    return _diagnosis(config, search, [], [], (now, now), ("nothing-to-explain", statement))


@dataclass(frozen=True)
class _Data:
    """The logs of a diagnosis and what is known of them; see `diagnose`."""

    paths: Sequence[Path | MemoryLog]
    truths: Sequence[Path | MemoryLog | None] | None
    mass_kg: float | None
    channel: str | None
    progress: Progress

    def problem(self, config: Config) -> Problem:
        """Read and decode the logs by a config. Errors: LogError where none of them can be used."""
        base = effects_of(config)
        drives, failed, useless = [], [], []
        for i, path in enumerate(self.paths):
            self.progress(f"reading {path.name}", 0.3 * i / len(self.paths))
            truth = self.truths[i] if self.truths else None
            try:
                drive = Drive.load(path, config, self.channel)
                run = drive.run(base)
                reference = reference_for(drive, run, truth=truth, mass_kg=self.mass_kg)
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
        return problem


def _search(
    problem: Problem, config: Config, switches: Sequence[str], progress: Progress
) -> tuple[Search, list[Tried]]:
    progress("trying every effect", 0.3)
    present = switching_roles(problem, [r for r in switches if r in config.signals])
    candidates = candidates_for(problem, present)
    base = effects_of(config)
    done = 0

    def on_candidate(label: str) -> None:
        nonlocal done
        done += 1
        progress(f"trying {label}", 0.3 + 0.25 * min(1.0, done / len(candidates)))

    search = Search(problem, base, candidates, on_candidate)
    tried = search.alone()
    progress("comparing sets of effects", 0.55)
    search.run()
    return search, tried
