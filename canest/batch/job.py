"""One log to replay, with what belongs to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from canest.core.errors import UsageError
from canest.logs.budget import LogBudget, current_budget, log_budget
from canest.logs.compression import ARCHIVE_SUFFIXES

if TYPE_CHECKING:
    from canest.config import Config
    from canest.offline.replay import Progress, ReplayResult

TRUTH_SUFFIX = ".truth.csv"


@dataclass(frozen=True, slots=True)
class Job:
    """One log to replay, with what belongs to it."""

    log: Path
    output: Path | None = None
    report: Path | None = None
    truth: Path | None = None
    mass_kg: float | None = None
    after_s: float = 60.0
    channel: str | None = None
    budget: LogBudget = field(default_factory=current_budget)  #: it runs in another process, perhaps

    @property
    def name(self) -> str:
        """The log's name without its suffixes: drive of drive.log.xz."""
        return name_of(self.log)

    def run(self, config: Config, progress: Progress | None = None) -> ReplayResult:
        """Replay the log. Errors: CanestError."""
        with log_budget(self.budget):
            return self._run(config, progress)

    def _run(self, config: Config, progress: Progress | None) -> ReplayResult:
        from canest.offline.replay import replay
        from canest.offline.scoring import Reference

        recorder = None
        if self.report is not None:
            from canest.report.page import require_packages
            from canest.report.recorder import Recorder

            require_packages(self.report)
            recorder = Recorder()
        truth = None
        if self.truth is not None:
            from canest.logs.truth import read_truth

            truth = read_truth(self.truth)
        result = replay(
            self.log,
            config,
            output=self.output,
            reference=Reference(truth, self.mass_kg, self.after_s),
            listener=recorder,
            progress=progress,
            channel=self.channel,
        )
        if recorder is not None and self.report is not None:
            from canest.report.replay_page import write_replay_report

            write_replay_report(self.report, result, config, recorder, result.score)
        return result


def name_of(log: Path) -> str:
    """Return a log's name without the suffixes of archive and format."""
    stem = Path(log.stem) if log.suffix.lower() in ARCHIVE_SUFFIXES else log
    return stem.stem or log.name


def truth_beside(log: Path) -> Path | None:
    """Return NAME.truth.csv beside a log (plain or compressed), None when there is none."""
    for suffix in ("", *ARCHIVE_SUFFIXES):
        path = log.with_name(name_of(log) + TRUTH_SUFFIX + suffix)
        if path.is_file():
            return path
    return None


def truth_file(log: Path, truth: str | None) -> Path | None:
    """Return the truth of a log that --truth names: a file, 'auto' for the one beside it, or none.

    Errors: UsageError when 'auto' finds none.
    """
    if truth != "auto":
        return Path(truth) if truth is not None else None
    found = truth_beside(log)
    if found is None:
        expected = log.with_name(name_of(log) + TRUTH_SUFFIX)
        raise UsageError("--truth auto: no truth beside the log", where=str(log), expected=str(expected))
    return found
