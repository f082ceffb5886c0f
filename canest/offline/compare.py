"""Every estimator on one log, side by side: one decoding, one model, many estimators."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core import jit
from canest.core.errors import PluginError
from canest.core.estimates import Estimates
from canest.core.frames import FloatColumn, IntColumn, MonotonicClock
from canest.core.samples import STEP_S, EstimateBlock, ModelBlock, Status
from canest.doctor.config_warnings import config_warnings
from canest.doctor.warnings import stream_warnings
from canest.estimators import registry
from canest.estimators.base import Estimator
from canest.estimators.contract import updated
from canest.grid.grid import Grid
from canest.logs.log_warnings import log_warnings
from canest.offline.replay import compiling_pays
from canest.offline.scoring import Reference, Score
from canest.offline.signals import ticks_of
from canest.pipeline.assumed_constants import carry_over
from canest.pipeline.build import PipelineSpec, build
from canest.pipeline.intake import Intake
from canest.pipeline.model_stream import ModelStream
from canest.pipeline.table_map import TableMap, open_for

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canest.config import Config
    from canest.logs.memory import MemoryLog
    from canest.offline.log_run import Progress


#: "within 5 %" counts from the first moment at which the error stays below for this long (or to the end)
WITHIN_PCT, WITHIN_HOLD_S = 5.0, 10.0
#: samples of the untimed first run, in which kernels are compiled or loaded
WARM_UP_SAMPLES = 64


@dataclass(frozen=True, slots=True)
class Comparison:
    """What came out.

    table: {"estimators": {NAME: {mass_end_pct, mass_rms_pct, mass_max_pct, grade_rms_deg, to_5pct_s,
    ns_per_sample, note}}, "default": NAME, "compiled": bool, "notes": [what a user should know of the log]};
    None where a number does not apply.
    estimates: NAME -> its estimates, one row per 50 Hz sample. true_mass_kg, true_grade, speed_mps
    (unfiltered): (n,), NaN where unknown.
    """

    table: dict[str, Any]
    estimates: dict[str, Estimates]
    true_mass_kg: FloatColumn
    true_grade: FloatColumn
    speed_mps: FloatColumn


@dataclass(slots=True)
class _Entry:
    """One estimator under comparison."""

    estimator: Estimator
    parts: list[Estimates] = field(default_factory=list)
    seconds: float = 0.0
    warm: bool = False
    failure: str = ""  #: why it ended before the log


def compare(
    config: Config,
    log: str | Path | MemoryLog,
    *,
    reference: Reference = Reference(),  # noqa: B008 - frozen
    names: Sequence[str] | None = None,
    channel: str | None = None,
    compiled: bool | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Run the estimators ``names`` (all by default, those of other packages too) on one log.

    The options of the config belong to its own estimator; the others run with their defaults. compiled:
    None decides by the length of the log. Errors: LogError, ConfigError (an unknown name).
    """
    on = jit.enable(compiling_pays([log]) if compiled is None else compiled)
    spec = build(config)
    chosen = spec.estimator

    def new(name: str) -> Estimator:
        return chosen.create() if name == chosen.name else registry.create(name, chosen.facts)

    notes: list[str] = []
    entries = _entries(names, new, notes)
    blocks: list[ModelBlock] = []
    if not names:
        notes += [f"estimator {name} is left out: {why}" for name, why in registry.skipped().items()]
    if compiled and not on:
        notes.append("--compiled: numba is not there, or has nowhere to keep what it compiles: interpreted")
    for plain, excited in _samples(config, spec, log, channel, progress, notes):
        blocks.append(plain[0])
        for name, entry in entries.items():
            block, again = excited if entry.estimator.wants_excitation_gate else plain
            if again and not entry.failure:
                entry.estimator = carry_over(new(name), float(entry.parts[-1].mass_kg[-1]), None)
            _run(entry, block)
    estimates = {name: Estimates.concatenate(entry.parts) for name, entry in entries.items()}
    score = reference.score()
    times = np.concatenate([b.t_us for b in blocks]) if blocks else np.empty(0, np.int64)
    true_mass, true_grade = score.truth_at(times)
    scores = {name: reference.score() for name in entries}
    table = {
        "estimators": {
            name: _row(entry, estimates[name], true_mass, scores[name]) for name, entry in entries.items()
        },
        "default": chosen.name,
        "compiled": jit.enabled(),
        "notes": notes
        + list(dict.fromkeys(note for s in scores.values() for note in s.notes()))
        + score.beyond(config.vehicle.mass_min_kg, config.vehicle.mass_max_kg),
    }
    speed = np.concatenate([b.raw_speed_mps for b in blocks]) if blocks else np.empty(0)
    return Comparison(table, estimates, true_mass, true_grade, speed)


def _entries(
    names: Sequence[str] | None, new: Callable[[str], Estimator], notes: list[str]
) -> dict[str, _Entry]:
    """Return the estimators that were asked for, or all that can be made, and note the others."""
    entries = {}
    for name in names or registry.names():
        try:
            entries[name] = _Entry(new(name))
        except PluginError as error:
            if names:
                raise
            notes.append(f"estimator {name} is left out: {error}")
    return entries


_Samples = tuple[ModelBlock, bool]  #: and whether estimators must begin anew before them


def _samples(
    config: Config,
    spec: PipelineSpec,
    log: str | Path | MemoryLog,
    channel: str | None,
    progress: Progress | None,
    notes: list[str],
) -> Iterator[tuple[_Samples, _Samples]]:
    """Yield the samples of a log, without and with the low-excitation gate; add to ``notes`` at its end."""
    intake, grid = Intake(spec.intake), Grid(spec.grid.channels, spec.grid.hold_us)
    tables = TableMap(config, log)
    plain, excited = (
        ModelStream(spec.model, spec.assumed, excitation_gate=gate, road=spec.road) for gate in (False, True)
    )

    reader = open_for(config, log, channel)
    for ticks in ticks_of(reader, tables, intake, grid, progress):
        yield from zip(plain.process(ticks), excited.process(ticks), strict=True)
    notes += config_warnings(config) + log_warnings(reader) + tables.warnings()
    notes += stream_warnings(intake, plain.stuck_ticks)


def _run(entry: _Entry, block: ModelBlock) -> None:
    """Give one estimator the next samples; its cost is processor time, whatever else is running."""
    try:
        e = _no_estimates(block) if entry.failure else _updated(entry, block)
    except PluginError as error:
        entry.failure, e = str(error), _no_estimates(block)
    entry.parts.append(
        Estimates(block.t_us, e.mass_kg, e.mass_std_kg, e.grade, e.grade_std, e.status, block.gate)
    )


def _updated(entry: _Entry, block: ModelBlock) -> EstimateBlock:
    if not entry.warm:
        entry.warm = True
        first = registry.create(entry.estimator.name, entry.estimator.facts)
        updated(first, block[:WARM_UP_SAMPLES])
    begin = time.thread_time()
    e = updated(entry.estimator, block)
    entry.seconds += time.thread_time() - begin
    return e


def _no_estimates(block: ModelBlock) -> EstimateBlock:
    nothing = np.full(len(block), np.nan)
    return EstimateBlock(nothing, nothing, nothing, nothing, np.zeros(len(block), np.uint8))


def _row(entry: _Entry, estimates: Estimates, true_mass_kg: FloatColumn, score: Score) -> dict[str, Any]:
    """Return one estimator's line of the table."""
    n = len(estimates)
    row: dict[str, Any] = dict.fromkeys(
        ("mass_end_pct", "mass_rms_pct", "mass_max_pct", "grade_rms_deg", "to_5pct_s", "ns_per_sample")
    )
    note = entry.failure or entry.estimator.missing()
    if note or not n:
        return {**row, "note": note or "no samples in this log"}
    score.add(estimates)
    errors = score.errors()
    row["grade_rms_deg"] = errors["grade_rms_deg"]
    row["ns_per_sample"] = entry.seconds / n * 1e9
    if not entry.estimator.estimates_mass:
        return {**row, "note": f"keeps the mass it is given ({estimates.mass_kg[-1]:,.0f} kg)"}
    estimated = estimates.status != Status.UNESTIMATED
    if not estimated.any():
        return {**row, "note": "never learned from this log"}
    row["mass_rms_pct"], row["mass_max_pct"] = errors["mass_rms_pct"], errors["mass_max_pct"]
    error_pct = 100.0 * (estimates.mass_kg / true_mass_kg - 1.0)
    if np.isfinite(error_pct[-1]):
        row["mass_end_pct"] = float(error_pct[-1])
    row["to_5pct_s"] = time_to(np.where(estimated, error_pct, np.nan), estimates.t_us)
    return {**row, "note": ""}


def time_to(error_pct: FloatColumn, t_us: IntColumn) -> float | None:
    """Return the seconds to the first sample from which the error stays small for the hold time.

    t_us: stamps of the samples (n,); time goes on where the clock was set back.
    """
    passed_s = (MonotonicClock()(t_us) - t_us[:1]) * 1e-6
    with np.errstate(invalid="ignore"):
        outside = np.flatnonzero(~(np.abs(error_pct) <= WITHIN_PCT))
    n = len(error_pct)
    begins, ends = np.concatenate(([0], outside + 1)), np.concatenate((outside, [n]))
    stays = ends > begins
    begins, ends = begins[stays], ends[stays]
    took_s = passed_s[np.minimum(ends, n - 1)] - passed_s[begins]
    # a shorter stay counts when the log ends inside it
    enough = np.flatnonzero((took_s >= WITHIN_HOLD_S - 0.5 * STEP_S) | (ends == n))
    return float(passed_s[begins[enough[0]]]) if len(enough) else None
