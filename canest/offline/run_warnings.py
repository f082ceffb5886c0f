"""What was odd about a log, its config and their truth: the notes of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canest.doctor.config_warnings import config_warnings
from canest.doctor.missing_signals import missing_signal_warnings
from canest.doctor.sparse_columns import sparse_column_warnings
from canest.doctor.warnings import stale_warnings, stream_warnings
from canest.logs.log_warnings import log_warnings

if TYPE_CHECKING:
    from canest.offline.log_run import LogRun
    from canest.offline.scoring import Score


def run_warnings(run: LogRun, score: Score | None) -> list[str]:
    """Return it in sentences, of a run that has ended."""
    pipeline, config = run.pipeline, run.config
    found = config_warnings(config, run.unmapped_groups.came)
    found += log_warnings(run.reader) + run.table_map.warnings()
    found += stream_warnings(pipeline.intake, pipeline.stuck_ticks) + stale_warnings(config, pipeline)
    found += sparse_column_warnings(run)
    if pipeline.updated:
        found += missing_signal_warnings(config, pipeline.intake.received) + run.unmapped_groups.hints()
    if warning := pipeline.estimator.contradiction():
        found.append(warning)
    found += run.past_contradiction.notes(warning)
    if run.mass_jump.found:
        found.append(run.mass_jump.found)
    if score is not None:
        v = config.vehicle
        found += score.notes() + score.beyond(v.mass_min_kg, v.mass_max_kg)
    return found
