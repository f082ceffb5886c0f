"""What a statistic means for the reader, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from canest.core.samples import RATE_HZ
from canest.report.gate_colours import look as gate_look

#: standard normal beyond this once in 370 times by chance
_Z_MAX = 3.0
#: share of the residual's variance that the second before explains, as a correlation
_CORRELATED = 0.3
#: mean squares of this many times the variance (gated, correlated data: generous)
_NIS_LOW, _NIS_HIGH = 0.5, 2.0
#: fewer seconds make no statistic
_FEW_S = 60
_DIAGNOSE = "canest diagnose looks for it"


class Verdict(NamedTuple):
    """One sentence. tone: "good", "warn", "bad", or "" where there is too little data."""

    text: str
    tone: str = ""


def of_correlation(correlation: float) -> Verdict:
    """Judge the correlation of residuals one second apart."""
    if math.isnan(correlation):
        return Verdict("too few residuals to judge")
    if abs(correlation) < _CORRELATED:
        return Verdict("neighbouring residuals hardly correlate: nothing systematic is left", "good")
    if correlation < 0:
        return Verdict("residuals swing to and fro: torque and speed may be shifted in time", "warn")
    return Verdict(f"residuals last for seconds: the model lacks something slow; {_DIAGNOSE}", "warn")


def of_runs(z: float, what: str = "residuals") -> Verdict:
    """Judge a runs test: the number of changes of sign against what chance gives, in standard deviations.

    The number is negative where there are fewer changes than by chance.
    """
    if math.isnan(z):
        return Verdict(f"too few {what} to judge")
    if abs(z) <= _Z_MAX:
        return Verdict(f"{what} change sign as often as by chance: no effect is seen to be missing", "good")
    if z < 0:
        return Verdict(f"{what} keep their sign too long: an effect is missing; {_DIAGNOSE}", "bad")
    return Verdict(
        f"{what} change sign too often: a signal jitters, or torque and speed are shifted in time; "
        "try a lower filter.cutoff_hz",
        "warn",
    )


def of_nis(nis: float) -> Verdict:
    """Judge the mean squared innovation over its expected value."""
    if math.isnan(nis):
        return Verdict("too few innovations to judge")
    if nis > _NIS_HIGH:
        return Verdict("innovations are larger than the estimator expects: its bands are too narrow", "bad")
    if nis < _NIS_LOW:
        return Verdict(
            "innovations are smaller than expected: its bands are wider than needed, the safe side"
        )
    return Verdict("innovations are as large as the estimator expects: its bands can be trusted", "good")


def of_low_nis(low_nis: float) -> Verdict:
    """Judge the mean square of low-passed innovations over its expected value."""
    if low_nis > _NIS_HIGH:
        return Verdict(
            f"errors last longer than noise: its bands are {math.sqrt(low_nis):.1f} times as wide for them; "
            f"{_DIAGNOSE}",
            "warn",
        )
    return Verdict("innovations follow each other by chance: no error is seen to last", "good")


def of_residual(rms_N: float, weight_N: float) -> Verdict:
    """Judge the size of the residual by the slope that would cause it."""
    if not rms_N > 0 or not weight_N > 0:
        return Verdict("no mass to compare it with")
    slope_pct = 100 * rms_N / weight_N
    text = f"as much as a slope of {slope_pct:.1f} %"
    if slope_pct < 0.5:
        return Verdict(f"{text}: small", "good")
    if slope_pct < 1.5:
        return Verdict(f"{text}: usual while torque changes", "")
    return Verdict(f"{text}: large; check wheel radius, gear ratios and the torque's scale", "warn")


def of_count(seconds: int) -> Verdict:
    """Judge how much the statistics rest on."""
    if seconds < _FEW_S:
        return Verdict(f"under {_FEW_S} s: take all of this with care", "warn")
    return Verdict("enough to judge", "good")


def of_mass_error(error_pct: float, std_pct: float) -> Verdict:
    """Judge an error by the standard deviation that was stated with the last valid mass."""
    ratio = abs(error_pct) / std_pct if std_pct > 0 else math.nan
    if math.isnan(ratio):
        return Verdict("no standard deviation to compare it with")
    if ratio <= 2.0:
        return Verdict(f"{ratio:.1f} standard deviations: the band holds", "good")
    text = f"{ratio:.1f} standard deviations: the band is too narrow, or the truth is not"
    return Verdict(text, "warn" if ratio <= 3.0 else "bad")


def why_not_valid(s: Mapping[str, Any]) -> list[str]:
    """Return why the mass was not valid at the end or at all, one sentence each; s: summary.json."""
    if s["status"] == "valid":
        return []
    if s.get("reason"):
        return [f"At the end there is no estimate: {s['reason']}."]
    text = f"At the end the mass is not trusted yet: learned from {s['updated'] / RATE_HZ:,.0f} s of driving"
    if s["mass_kg"] and s["mass_std_kg"]:
        text += f", standard deviation {100 * s['mass_std_kg'] / s['mass_kg']:.1f} % of the mass"
    reasons = [text + "."]
    if s["samples"] and s["gates"]:
        gate, count = max(s["gates"].items(), key=lambda item: item[1])
        share = 100 * count / s["samples"]
        if share >= 20:
            reasons.append(f"The gate {gate} ({gate_look(gate)[1]}) took {share:.0f} % of the time.")
    reasons.append("What helps: accelerating and climbing in gear, without brakes, for some minutes.")
    return reasons
