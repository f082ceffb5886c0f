"""The rows of the table of trips: one per load leg of a log."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.gates import LABELS
from canest.fleet.recording import Recording, calendar
from canest.offline.leg import Leg
from canest.offline.legs import Legs

#: a residual of fewer seconds is no figure
_FEWEST_SECONDS = 20
_GATES_NAMED = 3


def trip_rows(legs: Legs, recording: Recording, of_log: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a log, in order of time; of one without a leg, one row without numbers.

    of_log: columns that all its rows share; its `reason` is that of a log without an estimate.
    """
    seconds, means = recording.seconds(), recording.open_seconds()
    found = legs.legs()
    if not found:
        yield {
            "leg": 0,
            "status": "unestimated",
            "stops": 0,
            "distance_m": 0.0,
            **of_log,
            **_start(recording),
        }
    for number, leg in enumerate(found, 1):
        rows = _within(leg, seconds)
        yield {
            **of_log,
            "leg": number,
            "load": leg.load,
            "start": calendar(np.array([round(leg.from_s * 1e6)]))[0],
            "duration_s": (leg.passed_us[1] - leg.passed_us[0]) / 1e6,
            **{
                name: getattr(leg, name)
                for name in (
                    "from_s", "to_s", "driving_s", "distance_m", "climb_m", "stops", "mass_kg",
                    "mass_std_kg", "valid_share", "status",
                )
            },
            "reason": _reason(leg, rows["gate"], str(of_log["reason"])),
            "reported_mass_kg": _reported(rows["reported_mass_kg"]),
            **_residual(leg, _within(leg, means)),
        }  # fmt: skip


def _within(leg: Leg, rows: Mapping[str, FloatColumn]) -> dict[str, FloatColumn]:
    first_us, last_us = leg.passed_us
    within = (rows["passed_us"] >= first_us) & (rows["passed_us"] <= last_us)
    return {name: column[within] for name, column in rows.items()}


def _start(recording: Recording) -> dict[str, Any]:
    if recording.first_us is None:
        return {}
    return {"start": calendar(np.array([recording.first_us]))[0], "from_s": recording.first_us / 1e6}


def _reason(leg: Leg, gate: FloatColumn, of_log: str) -> str:
    """Return why a leg has no valid mass, '' where it has one."""
    if leg.is_valid:
        return ""
    if of_log:
        return of_log
    closed = Counter(LABELS[int(code)] for code in gate.tolist())
    learned = closed.pop("", 0)
    shares = ", ".join(f"{name} {100 * n / len(gate):.0f} %" for name, n in closed.most_common(_GATES_NAMED))
    if leg.mass_std_kg and leg.mass_kg:
        spread = f"the standard deviation is {100 * leg.mass_std_kg / leg.mass_kg:.1f} % of the mass"
    else:
        spread = "nothing was learned"
    return f"{spread} after {learned} s with open gates" + (f" ({shares})" if shares else "")


def _reported(values: FloatColumn) -> float | None:
    # some controllers send 0 for "no estimate"
    sent = values[values > 0.0]
    return float(np.median(sent)) if len(sent) else None


def _residual(leg: Leg, means: Mapping[str, FloatColumn]) -> dict[str, float]:
    """Return the force residual m (a + g sin b + g mu cos b) - F, m the leg's mass, of means over seconds."""
    if leg.mass_kg is None:
        return {}
    residual = leg.mass_kg * means["needed_mps2"] - means["force_N"]
    known = np.isfinite(residual) & np.isfinite(means["traction_N"])
    r, traction = residual[known], means["traction_N"][known]
    if len(r) < _FEWEST_SECONDS:
        return {}
    found = {"residual_mean_N": float(r.mean()), "residual_rms_N": math.sqrt(float(r @ r) / len(r))}
    if float(traction @ traction) > 0.0:
        found["torque_residual_pct"] = 100.0 * float(r @ traction) / float(traction @ traction)
    return found
