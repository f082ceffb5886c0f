"""Numbers of a diagnosis as text, the same on the terminal and in the report."""

from __future__ import annotations

from canest.diagnosis.entries import Entry
from canest.diagnosis.run import Diagnosis
from canest.diagnosis.search.held_out import Score

_SCORES = (
    ("held-out residual RMS", "residual_rms_N", "{:,.0f} N"),
    ("mass at the end", "mass_kg", "{:,.0f} kg"),
    ("mean mass error", "mass_error_pct", "{:+.2f} %"),
    ("mass error RMS", "mass_rms_pct", "{:.2f} %"),
    ("grade error RMS", "grade_rms_deg", "{:.3f}°"),
)


def score_rows(diagnosis: Diagnosis) -> list[tuple[str, str, str, str]]:
    """Return the before-and-after table: label, key, before, after ('-' where there is no number)."""
    rows = []
    for label, key, form in _SCORES:
        before, after = getattr(diagnosis.before, key), getattr(diagnosis.after, key)
        if before is not None or after is not None:
            rows.append((label, key, _formatted(before, form), _formatted(after, form)))
    return rows


def interval(score: Score, key: str) -> str:
    """Return the 95 % confidence interval of one of a score's numbers, '' where there is none."""
    if key not in score.intervals:
        return ""
    number = next(form for _, k, form in _SCORES if k == key).split("}")[0] + "}"
    low, high = score.intervals[key]
    return f"[{number.format(low)} … {number.format(high)}]"


def _formatted(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def change(before: float, after: float) -> str:
    """Return the change in per cent, in words."""
    if before <= 0:
        return "unchanged"
    percent = 100.0 * (after / before - 1.0)
    return f"{abs(percent):.0f} % {'less' if percent < 0 else 'more'}"


def entry_name(entry: Entry) -> str:
    """Return an effect's name with what makes it one of several (gear, signal)."""
    shape = dict(entry.candidate.shape)
    extra = [f"{k} {shape[k]}" for k in ("gear", "signal", "cause") if shape.get(k) is not None]
    return entry.candidate.effect + (f" ({', '.join(extra)})" if extra else "")


def entry_value(entry: Entry) -> str:
    """Return value, standard deviation and unit of the fitted parameter, and whether its range ends there."""
    fitted = entry.parameters()[entry.candidate.parameter]
    end = " (end of range)" if entry.candidate.reached_end(entry.deviation) is not None else ""
    return f"{fitted['value']:.4g} ± {entry.std:.2g} {fitted['unit']}".strip() + end
