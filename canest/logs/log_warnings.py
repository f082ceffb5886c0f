"""What a user should know of a log or table beside its content: what could not be read."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canest.logs.base import LogReader

_LINES_SHOWN = 3


def log_warnings(reader: LogReader) -> list[str]:
    """Return what was wrong with a log that has been read to its end, one sentence each."""
    notes = [f"line {number} skipped: {reason}: {text!r}" for number, text, reason in
             reader.skipped[:_LINES_SHOWN]]  # fmt: skip
    if reader.skipped_lines > _LINES_SHOWN:
        numbers = ", ".join(str(number) for number, _, _ in reader.skipped[_LINES_SHOWN:])
        unnamed = reader.skipped_lines - len(reader.skipped)
        more = f" and {unnamed:,} after them" if unnamed else ""
        notes.append(f"{reader.skipped_lines - _LINES_SHOWN:,} more lines skipped: {numbers}{more}")
    notes += reader.remarks + truncation_warnings(reader)
    if reader.channel is None and len(reader.channels) > 1:
        notes.append(
            f"{len(reader.channels)} interfaces taken as one bus: {reader.channels_text()}; "
            "--channel NAME takes one"
        )
    return notes


def truncation_warnings(reader: LogReader) -> list[str]:
    """Return that a log which has been read ends before it should; nothing for one that is whole."""
    return [f"the log ends before it should: {reader.truncated_reason}"] if reader.truncated else []
