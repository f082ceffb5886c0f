"""Load legs, the last valid mass and its errors as sentences: the same in the terminal and in reports.

``s`` is always the content of summary.json.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from canest.core.samples import RATE_HZ

#: stamps after this are seconds since 1970, and after that of another unit; before, since some start
EPOCH_S, CALENDAR_END_S = 5e8, 32_503_680_000
#: loads whose masses a headline names one by one
_NAMED = 3


def clock_text(t_s: float) -> str:
    """Return a time of the log's own clock: of the day (UTC) where it is a calendar's, else in seconds."""
    if EPOCH_S < t_s < CALENDAR_END_S:
        return datetime.fromtimestamp(t_s, UTC).strftime("%H:%M:%S")
    return f"{t_s:,.0f} s"


def span_text(leg: Mapping[str, Any]) -> str:
    """Return from when to when a leg goes."""
    first, last = clock_text(leg["from_s"]), clock_text(leg["to_s"])
    return f"{first.removesuffix(' s')} to {last}"


def kg_text(mass_kg: float, std_kg: float | None) -> str:
    """Return a mass with its standard deviation."""
    return f"{mass_kg:,.0f}" + (f" +- {std_kg:,.0f}" if std_kg is not None else "") + " kg"


def loads(s: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the legs with a valid mass."""
    return [leg for leg in s["legs"] if leg["load"] is not None]


def mass_text(s: Mapping[str, Any]) -> str:
    """Return the last valid mass, how much of the driving was valid, and the state at the end."""
    if s["mass_kg"] is None and s["last_valid"] is None:
        return "none"
    share = f"{100 * s['valid_share']:.0f} % of the driving valid"
    end = kg_text(s["mass_kg"], s["mass_std_kg"]) if s["mass_kg"] is not None else "no number"
    if s["last_valid"] is None:
        return f"{end} at the end ({s['status']}, never valid, estimator {s['estimator']})"
    if s["status"] == "valid":
        return f"{end} at the end (valid, estimator {s['estimator']}; {share})"
    last = s["last_valid"]
    text = (
        f"{kg_text(last['mass_kg'], last['mass_std_kg'])}, last valid at {clock_text(last['t_s'])} ({share}, "
    )
    return text + f"estimator {s['estimator']}); at the end {s['status']}, {end}"


def leg_text(leg: Mapping[str, Any]) -> str:
    """Return a leg as one line: mass, when, how far, how much of it valid, and its error."""
    mass = "no mass" if leg["mass_kg"] is None else kg_text(leg["mass_kg"], leg["mass_std_kg"])
    text = f"{mass}, {span_text(leg)}, {leg['distance_m'] / 1e3:,.1f} km, "
    text += f"{100 * leg['valid_share']:.0f} % valid" if leg["load"] is not None else leg["status"]
    if leg["mass_error_pct"] is not None:
        text += f", {leg['mass_error_pct']:+.1f} % of the true {leg['true_mass_kg']:,.0f} kg"
    return text


def headline(s: Mapping[str, Any]) -> str:
    """Return one sentence: the loads, how much of the driving was valid, and the error there."""
    if s["mass_kg"] is None and s["last_valid"] is None:
        return "No estimate" + (f": {s['reason']}" if s.get("reason") else "")
    found = loads(s)
    share = f"valid for {100 * s['valid_share']:.0f} % of the driving"
    if not found:
        text = mass_text(s)
    elif len(found) == 1:
        text = f"{kg_text(found[0]['mass_kg'], found[0]['mass_std_kg'])}, {share}"
    elif len(found) <= _NAMED:
        named = [kg_text(leg["mass_kg"], leg["mass_std_kg"]) for leg in found]
        text = f"{len(found)} loads, {', '.join(named[:-1])} and {named[-1]}, {share}"
    else:
        masses = [leg["mass_kg"] for leg in found]
        text = f"{len(found)} loads between {min(masses):,.0f} and {max(masses):,.0f} kg, {share}"
    settled = s.get("errors", {}).get("settled")
    if settled and settled["mass_rms_pct"] is not None:
        text += f"; over the settled legs the mass is within {settled['mass_rms_pct']:.1f} % RMS of the truth"
    return text.replace("+-", "±")


def settled_text(errors: Mapping[str, Any], driving_s: float) -> str:
    """Return the errors over the settled legs, and how much of the driving they are."""
    settled = errors["settled"]
    parts = error_parts(settled)
    if not settled["samples"]:
        return "none over settled legs: no leg had a valid mass"
    if not parts:
        return "none over settled legs: nowhere is the truth known"
    share = f" ({100 * settled['samples'] / RATE_HZ / driving_s:.0f} % of the driving)" if driving_s else ""
    return f"{', '.join(parts)} over the settled legs{share}"


def error_parts(errors: Mapping[str, Any]) -> list[str]:
    """Return the errors of mass and grade that could be counted."""
    parts = []
    if errors["mass_rms_pct"] is not None:
        parts.append(f"mass RMS {errors['mass_rms_pct']:.2f} %, worst {errors['mass_max_pct']:.2f} %")
    if errors["grade_rms_deg"] is not None:
        parts.append(f"grade RMS {errors['grade_rms_deg']:.3f} degrees")
    return parts
