"""The text of a table's cell as a number or a time."""

from __future__ import annotations

from datetime import UTC, datetime

_TRUTH = {"false": 0.0, "true": 1.0}


def number_of(cell: str) -> float | None:
    """Return the number in a cell (of a truth value 0 or 1, as parquet has it), None for text and nothing."""
    try:
        return float(cell)
    except ValueError:
        return _TRUTH.get(cell.strip().lower())


def seconds_of(cell: str) -> float | None:
    """Return the time in a cell: a number, or the seconds since 1970 of a date and time (ISO 8601).

    None for other text and for nothing.
    """
    seconds = number_of(cell)
    if seconds is not None:
        return seconds
    try:
        return seconds_since_1970(datetime.fromisoformat(cell.strip()))
    except ValueError:
        return None


def seconds_since_1970(when: datetime) -> float:
    """Return a date and time in seconds; without a zone it is UTC, as it is in parquet."""
    return (when if when.tzinfo is not None else when.replace(tzinfo=UTC)).timestamp()
