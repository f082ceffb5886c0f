"""The daemon's condition as one JSON-ready dictionary: for ``canest status``, metrics and the log.

The keys are a public contract. A deprecated key stays beside the one that replaces it (docs/service.md).
"""

from __future__ import annotations

import math
from typing import Any

from canest.core.gates import LABELS
from canest.core.samples import RATE_HZ, Status
from canest.doctor.missing_signals import missing_signal_warnings
from canest.node.estimate_frame import STATUS_NAMES
from canest.telemetry.daemon_view import DaemonView
from canest.telemetry.sender_tables import (
    address,
    busiest_others,
    contested_signals,
    sender_key,
    used_senders,
)
from canest.telemetry.status_text import NOT_AVAILABLE, why_not_valid

#: deprecated name of a counter of the node -> its name
DEPRECATED_COUNTERS = {"claims_heard": "claims_received", "cannot_claim_heard": "cannot_claim_received"}
PATIENCE_TICKS = round(30 * RATE_HZ)  #: before a signal counts as one that nobody sends


def snapshot(view: DaemonView) -> dict[str, Any]:
    """Return the condition of a daemon."""
    result = {
        "vehicle": view.config.vehicle.name,
        "config": view.config_name,
        "pid": view.pid,
        "uptime_s": round((view.now_us - view.started_us) * 1e-6, 1),
        "bus": _bus(view),
        "estimate": _estimate(view),
        **_learning(view),
        "broadcast": _broadcast(view),
        **_senders(view),
        **_signals(view),
        "ticks": _ticks(view),
        "files": _files(view),
        "failures": view.failures,
        "reloads": view.reloads.accepted,
        "reloads_refused": view.reloads.refused,
        "reload_refused_because": view.reloads.refused_because,
    }
    if view.last is not None:
        result["last_known"] = {
            "mass_kg": _number(view.last.estimate.mass_kg, 1),
            "mass_std_kg": _number(view.last.estimate.mass_std_kg, 1),
            "status": STATUS_NAMES[view.last.estimate.status],
            "age_s": round(view.last.age_s, 1),
        }
    if view.learned is not None:
        result["learned"] = {
            "mass_kg": round(view.learned.mass_kg, 1),
            "mass_std_kg": round(view.learned.mass_std_kg, 1),
            "saved_s": round(view.learned.saved_s, 1),
            "distance_km": view.learned.distance_km,
        }
    ahead = view.pipeline.road_ahead()
    if ahead is not None:
        result["road_ahead"] = dict(zip(("distance_m", "grade"), ahead, strict=True))
    return result


def flat(value: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested dictionaries as one level of dotted keys, for a line of the log."""
    level: dict[str, Any] = {}
    for key, inner in value.items():
        if key == "road_ahead":  # a picture, and no line
            continue
        if isinstance(inner, dict):
            level |= flat(inner, f"{prefix}{key}.")
        else:
            level[prefix + key] = inner
    return level


def _bus(view: DaemonView) -> dict[str, Any]:
    counters = view.pipeline.decoder.counters
    return {
        "interface": view.config.bus.interface,
        "channel": view.config.bus.channel,
        "state": view.receiver.state,
        "reason": view.receiver.reason,
        "frames_per_s": round(view.rates.frames_per_s, 1),
        "quiet_s": None if view.quiet_s is None else round(view.quiet_s, 1),
        "frames": counters.frames,
        "wanted": counters.wanted,
        "opened": view.receiver.opened,
        "late_frames": view.late_frames,
        **view.receiver.counters,
    }


def _estimate(view: DaemonView) -> dict[str, Any]:
    estimate = view.estimate
    return {
        "mass_kg": _number(estimate.mass_kg, 1),
        "mass_std_kg": _number(estimate.mass_std_kg, 1),
        "grade": _number(estimate.grade, 6),
        "grade_std": _number(estimate.grade_std, 6),
        "status": STATUS_NAMES[estimate.status],
        "gate": LABELS.get(estimate.gate, NOT_AVAILABLE),
    }


def _learning(view: DaemonView) -> dict[str, Any]:
    """Return what the estimator has learned from, and what it lacks."""
    pipeline = view.pipeline
    # a bus that has just been switched on has not carried every signal yet
    settled = pipeline.samples > PATIENCE_TICKS
    missing = missing_signal_warnings(view.config, pipeline.intake.received) if settled else []
    return {
        "missing_signals": missing,
        "notes": view.notes,
        "unheard": missing,  # deprecated
        "why_not_valid": why_not_valid(view),
        "samples": pipeline.samples,
        "updated": pipeline.updated,
        "gates": pipeline.gate_counts,
        "clock": dict(pipeline.clock.counters),
    }


def _broadcast(view: DaemonView) -> dict[str, Any]:
    node, counters = view.node, view.node.counters()
    deprecated = {old: counters[new] for old, new in DEPRECATED_COUNTERS.items() if new in counters}
    return {
        "address": node.address,
        "silent_because": node.silence_reason(view.now_us),
        "other_users_of_our_group": node.other_group_users,
        **counters,
        **deprecated,
    }


def _senders(view: DaemonView) -> dict[str, Any]:
    """Return who sends what, and which senders may not be the ECU whose address they use."""
    counters, monitor, rates = view.pipeline.decoder.counters, view.node.monitor, view.sender_rates
    return {
        "senders": used_senders(counters),
        "other_senders": busiest_others(counters.other_senders),
        "other_senders_count": len(counters.other_senders),
        "contested_signals": contested_signals(counters),
        "sends_faster": {
            sender_key(key): [round(usual_hz, 1), round(now_hz, 1)]
            for key, (usual_hz, now_hz) in rates.faster.items()
        },
        "sent_faster_s": {sender_key(key): round(s) for key, s in rates.faster_s.items()},
        "claims": {address(a): n for a, n in sorted(monitor.claimed.items())},
        "torque_commands": {address(a): n for a, n in sorted(monitor.torque_commands.items())},
    }


def _signals(view: DaemonView) -> dict[str, Any]:
    pipeline = view.pipeline
    stuck_s = {role: round(n / RATE_HZ, 1) for role, n in pipeline.stuck_ticks.items()}
    masses = view.node.monitor.other_masses
    return {
        "transport": dict(pipeline.decoder.counters.transport),
        "implausible_jumps": dict(pipeline.intake.range_rate_check.refused),
        "stuck_signals": stuck_s,
        "frozen_signals": stuck_s,  # deprecated
        "masses_of_others_kg": {address(a): m.mass_kg for a, m in sorted(masses.items())},
        "masses_of_others_pct": _against_ours(view, {address(a): m.mass_kg for a, m in masses.items()}),
    }


def _against_ours(view: DaemonView, masses_kg: dict[str, float]) -> dict[str, float]:
    """Return how much more than ours others report, %; nothing while ours is not valid."""
    ours = view.estimate
    if ours.status != Status.VALID or not ours.mass_kg > 0.0:
        return {}
    return {a: round(100.0 * (kg / ours.mass_kg - 1.0), 2) for a, kg in sorted(masses_kg.items())}


def _ticks(view: DaemonView) -> dict[str, Any]:
    return {
        "count": view.ticks.ran,
        "missed": view.ticks.missed,
        "within_half_ms": round(view.ticks.within_half_ms, 5),
        "cpu_us_mean": round(view.rates.cpu_us_per_tick, 1),
        "cpu_us_max": round(view.rates.cpu_us_max, 1),
    }


def _files(view: DaemonView) -> dict[str, Any]:
    failures = view.background.failures.copy()  # the writing thread changes it
    return {**view.background.counters, **{f"{kind}_error": text for kind, text in failures.items()}}


def _number(value: float, digits: int) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None
