"""All that a person on call needs, as one JSON-ready dictionary: for status, metrics and the log."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from canest.core.gates import LABELS
from canest.core.samples import RATE_HZ, STEP_S
from canest.doctor.missing_signals import missing_signal_warnings
from canest.doctor.reasons import why_no_signal
from canest.node.estimate_frame import STATUS_WORDS

if TYPE_CHECKING:
    from canest.live.daemon import Daemon

NOT_AVAILABLE = "not available"
#: most senders listed: noise from every address must not make a snapshot long
MOST_SENDERS, MOST_OTHERS = 100, 20
PATIENCE_TICKS = round(30 * RATE_HZ)  #: before a signal counts as one that nobody sends


def snapshot(daemon: Daemon, now_us: int) -> dict[str, Any]:
    """Return the daemon's condition at ``now_us`` (microseconds of the monotonic clock)."""
    pipeline, counters = daemon.pipeline, daemon.pipeline.decoder.counters
    node, receiver = daemon.node, daemon.receiver
    estimate = daemon.estimate(now_us)
    result: dict[str, Any] = {
        "vehicle": daemon.config.vehicle.name,
        "config": daemon.config_name,
        "pid": daemon.pid,
        "uptime_s": round((now_us - daemon.started_us) * 1e-6, 1),
        "bus": {
            "interface": daemon.config.bus.interface,
            "channel": daemon.config.bus.channel,
            "state": receiver.state,
            "reason": receiver.reason,
            "frames_per_s": round(daemon.rates.frames_per_s, 1),
            "frames": counters.frames,
            "wanted": counters.wanted,
            "opened": receiver.opened,
            "late_frames": daemon.late_frames,
            **receiver.counters,
        },
        "estimate": {
            "mass_kg": _number(estimate.mass_kg, 1),
            "mass_std_kg": _number(estimate.mass_std_kg, 1),
            "grade": _number(estimate.grade, 6),
            "grade_std": _number(estimate.grade_std, 6),
            "status": STATUS_WORDS[estimate.status],
            "gate": LABELS.get(estimate.gate, NOT_AVAILABLE),
        },
        # a bus that has just woken up is still telling what it has
        "unheard": missing_signal_warnings(daemon.config, pipeline.intake.received)
        if pipeline.samples > PATIENCE_TICKS
        else [],
        "why_not_valid": why_not_valid(daemon, now_us),
        "samples": pipeline.samples,
        "updated": pipeline.updated,
        "gates": pipeline.gate_counts,
        "clock": dict(pipeline.clock.counters),
        "broadcast": {
            "address": node.address,
            "silent_because": node.silence(now_us),
            "other_users_of_our_group": sorted(a for a in node.watch.group_users if a != node.address),
            **node.counters(),
        },
        "senders": _senders(daemon),
        "other_senders": {_sender_key(key): frames for key, frames in _busiest(counters.other_senders)},
        "other_senders_count": len(counters.other_senders),
        "contested_signals": {
            role: {_address(a): n for a, n in sorted(refused.items(), key=_by_count)[:MOST_OTHERS]}
            for role, refused in counters.contested().items()
        },
        "sends_faster": {
            _sender_key(key): [round(usual, 1), round(now, 1)]
            for key, (usual, now) in daemon.paces.faster.items()
        },
        "sent_faster_s": {_sender_key(key): round(s) for key, s in daemon.paces.seconds.items()},
        "claims": {_address(a): n for a, n in sorted(node.watch.claimed.items())},
        "torque_commands": {_address(a): n for a, n in sorted(node.watch.torque_commands.items())},
        "transport": dict(counters.transport),
        "implausible_jumps": dict(pipeline.intake.range_rate_check.refused),
        "frozen_signals": {role: round(n / RATE_HZ, 1) for role, n in pipeline.stuck_ticks.items()},
        "masses_of_others_kg": {_address(a): m.mass_kg for a, m in sorted(node.watch.other_masses.items())},
        "ticks": {
            "count": daemon.schedule.ticks,
            "missed": daemon.schedule.missed,
            "within_half_ms": round(daemon.schedule.share_within(0.5), 5),
            "cpu_us_mean": round(daemon.rates.cpu_us_per_tick, 1),
            "cpu_us_max": round(daemon.rates.cpu_us_max, 1),
        },
        "files": {
            **daemon.background.counters,
            **{f"{k}_error": v for k, v in daemon.background.failures.copy().items()},  # a thread changes it
        },
        "failures": daemon.failures,
        "reloads": daemon.reloads.taken,
        "reloads_refused": daemon.reloads.refused,
        "reload_refused_because": daemon.reloads.refused_because,
    }
    learned = daemon.memory.learned
    if learned is not None:
        result["learned"] = {
            "mass_kg": round(learned.mass_kg, 1),
            "saved_s": round(learned.saved_s, 1),
            "distance_km": learned.distance_km,
        }
    return result


def why_not_valid(daemon: Daemon, now_us: int) -> str:
    """Return one sentence on what the estimate lacks ('' when it is valid)."""
    estimate, pipeline = daemon.estimate(now_us), daemon.pipeline
    status = STATUS_WORDS[estimate.status]
    if status == "valid":
        return ""
    if daemon.receiver.state not in ("up", "error-passive"):
        return f"the bus {daemon.config.bus.channel} is {bus_state(daemon)}"
    counters = pipeline.decoder.counters
    if not counters.frames:
        return f"nothing has been heard on {daemon.config.bus.channel} yet"
    if status == NOT_AVAILABLE:
        return f"no wanted frame for more than {daemon.config.sampling.hold_s:g} s: the bus is quiet"
    missing = pipeline.estimator.missing() or why_no_signal(daemon.config, counters, counters.frames)
    if missing := missing or pipeline.estimator.doubts():
        return missing
    gate = LABELS.get(estimate.gate, "")
    learned_s = pipeline.updated * STEP_S
    text = f"learned from {learned_s:.1f} s of driving so far"
    return f"{text}; now held back by the gate {gate}" if gate else text


def bus_state(daemon: Daemon) -> str:
    """Return the state of the bus, with the reason where there is one."""
    state, reason = daemon.receiver.state, daemon.receiver.reason
    return f"{state}: {reason}" if reason else state


def one_line(daemon: Daemon, now_us: int) -> str:
    """Return the line that ``systemctl status`` shows."""
    estimate = daemon.estimate(now_us)
    bus = f"{daemon.config.bus.channel} {daemon.receiver.state}, {daemon.rates.frames_per_s:.0f} frames/s"
    status = STATUS_WORDS[estimate.status]
    if math.isnan(estimate.mass_kg):
        return f"{status}: {why_not_valid(daemon, now_us)} ({bus})"
    # whole hundreds and tenths: a line that changes at every look would only fill the journal
    mass = f"mass {estimate.mass_kg / 1000:.1f} t +- {estimate.mass_std_kg / 1000:.1f}"
    gate = LABELS.get(estimate.gate, "")
    return f"{status}: {mass}, grade {100 * estimate.grade:.1f} %{f', gate {gate}' if gate else ''} ({bus})"


def _senders(daemon: Daemon) -> dict[str, dict[str, Any]]:
    senders: dict[str, dict[str, Any]] = {}
    for key, counted in sorted(daemon.pipeline.decoder.counters.senders.items(), key=_by_id):
        if counted.used and len(senders) < MOST_SENDERS:
            senders[_sender_key(key)] = {
                "frames": counted.frames,
                "rate_hz": None if counted.rate_Hz is None else round(counted.rate_Hz, 1),
                "not_available": counted.not_available,
                "error_values": counted.error_value,
                "wrong_length": counted.wrong_length,
                "unknown_mux": counted.unknown_mux,
                "remote_frames": counted.remote_frames,
                "transport_errors": counted.transport_errors,
            }
    return senders


def _busiest(senders: dict[tuple[int, int | None], int]) -> list[tuple[tuple[int, int | None], int]]:
    busiest = sorted(senders.items(), key=lambda item: -item[1])[:MOST_OTHERS]
    return sorted(busiest, key=_by_id)


def _by_id(item: tuple[tuple[int, int | None], Any]) -> tuple[int, int]:
    (group, source), _ = item
    return group, -1 if source is None else source


def _by_count(item: tuple[int | None, int]) -> int:
    return -item[1]


def sender_name(key: tuple[int, int | None]) -> str:
    """Return a sender in words: its group (or identifier) and address."""
    group, source = key
    return f"0x{group & 0x1FFF_FFFF:X}" if source is None else f"PGN {group} from {_address(source)}"


def _sender_key(key: tuple[int, int | None]) -> str:
    """Return a sender as a key, which a line of the log or a program can split off: pgn_61444_from_0x00."""
    return sender_name(key).replace("PGN ", "pgn_").replace(" ", "_")


def _address(source: int | None) -> str:
    return "unknown" if source is None else f"0x{source:02X}"


def _number(value: float, digits: int) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None


def flat(value: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested dictionaries as one level of dotted keys, for a line of the log."""
    level: dict[str, Any] = {}
    for key, inner in value.items():
        if isinstance(inner, dict):
            level |= flat(inner, f"{prefix}{key}.")
        else:
            level[prefix + key] = inner
    return level
