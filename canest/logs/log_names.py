"""What follows from a log's file name: the name of the drive, and the truth file beside it."""

from __future__ import annotations

from pathlib import Path

from canest.core.errors import UsageError
from canest.logs.compression import ARCHIVE_SUFFIXES

TRUTH_SUFFIX = ".truth.csv"


def log_name(log: Path) -> str:
    """Return a log's name without the suffixes of archive and format."""
    stem = Path(log.stem) if log.suffix.lower() in ARCHIVE_SUFFIXES else log
    return stem.stem or log.name


def truth_beside(log: Path) -> Path | None:
    """Return NAME.truth.csv beside a log (plain or compressed), None when there is none."""
    for suffix in ("", *ARCHIVE_SUFFIXES):
        path = log.with_name(log_name(log) + TRUTH_SUFFIX + suffix)
        if path.is_file():
            return path
    return None


def truth_file(log: Path, truth: str | None) -> Path | None:
    """Return the truth of a log for --truth: a file, 'auto' for the one beside it, or none.

    Errors: UsageError when 'auto' finds none.
    """
    if truth != "auto":
        return Path(truth) if truth is not None else None
    found = truth_beside(log)
    if found is None:
        expected = log.with_name(log_name(log) + TRUTH_SUFFIX)
        raise UsageError("--truth auto: no truth beside the log", where=str(log), expected=str(expected))
    return found
