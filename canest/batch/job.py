"""One log to replay, with what belongs to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from canest.logs.budget import LogBudget, current_budget, log_budget
from canest.logs.estimate_writer import open_writer
from canest.logs.log_names import log_name
from canest.offline.log_run import Progress
from canest.offline.replay import OpenWriter, Output, ReplayResult, replay

if TYPE_CHECKING:
    from canest.config import Config
    from canest.offline.scoring import Reference


@dataclass(frozen=True, slots=True)
class Job:
    """One log to replay, with what belongs to it."""

    log: Path
    output: Path | None = None
    report: Path | None = None
    report_script: str = ""  #: file beside the report that has plotly; '' where the report itself has it
    truth: Path | None = None
    mass_kg: float | None = None
    after_s: float = 60.0
    channel: str | None = None
    columns: tuple[str, ...] = ()  #: of the output, beside those of est.csv
    opened: OpenWriter = open_writer  #: how the output is opened
    budget: LogBudget = field(default_factory=current_budget)  #: it runs in another process, perhaps

    @property
    def name(self) -> str:
        """The log's name without its suffixes: drive of drive.log.xz."""
        return log_name(self.log)

    def run(self, config: Config, progress: Progress | None = None) -> ReplayResult:
        """Replay the log. Errors: CanestError."""
        with log_budget(self.budget):
            return self._run(config, progress)

    def _run(self, config: Config, progress: Progress | None) -> ReplayResult:
        recorder = None
        if self.report is not None:
            # wanted for a report alone
            from canest.report.page import require_packages
            from canest.report.recorder import Recorder

            require_packages(self.report)
            recorder = Recorder()
        result = replay(
            self.log,
            config,
            output=Output(self.output, self.columns, self.opened) if self.output is not None else None,
            reference=self._reference(),
            listener=recorder,
            tick_listener=recorder.track if recorder is not None else None,
            progress=progress,
            channel=self.channel,
        )
        if recorder is not None and self.report is not None:
            # as above
            from canest.report.replay_page import write_replay_report

            write_replay_report(self.report, result, config, recorder, result.score, self.report_script)
        return result

    def _reference(self) -> Reference | None:
        """Return what the estimates are compared with, None for nothing. Errors: CanestError."""
        if self.truth is None and self.mass_kg is None:
            return None
        from canest.logs.truth import read_truth  # as above
        from canest.offline.scoring import Reference  # wanted where a truth is known

        return Reference(
            read_truth(self.truth) if self.truth is not None else None, self.mass_kg, self.after_s
        )
