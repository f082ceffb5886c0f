"""A daemon's snapshot in a terminal: the estimate first, then what explains it."""

from __future__ import annotations

import time
from typing import Any

from canest.system import terminal

_COLOURS = {"valid": "green", "converging": "yellow"}
_NOT_A_FAULT = frozenset({"frames", "wanted", "late_frames", "opened"})


def show(snapshot: dict[str, Any], verbose: bool = False) -> None:
    """Print one snapshot."""
    from rich.markup import escape
    from rich.table import Table

    console = terminal.console(highlight=False)
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim")
    table.add_column()
    for name, value in rows(snapshot, verbose):
        table.add_row(name, escape(value))
    colour = _COLOURS.get(snapshot["estimate"]["status"], "red")
    console.print(
        f"[bold]{escape(snapshot['vehicle'])}[/bold] on {escape(snapshot['bus']['channel'])}: "
        f"[{colour}]{snapshot['estimate']['status']}[/{colour}]"
    )
    console.print(table)


def rows(snapshot: dict[str, Any], verbose: bool = False) -> list[tuple[str, str]]:
    """Return (label, text) lines."""
    estimate, bus, node, ticks = (snapshot[k] for k in ("estimate", "bus", "broadcast", "ticks"))
    lines = [("estimate", _estimate(estimate))]
    if estimate["mass_kg"] is None and (known := _last_known(snapshot)):
        lines.append(("last known", known))
    if snapshot["why_not_valid"]:
        lines.append(("why not valid", snapshot["why_not_valid"]))
    lines += [("missing", sentence) for sentence in snapshot.get("missing_signals", ())]
    lines += [("note", sentence) for sentence in snapshot.get("notes", ())]
    if estimate["gate"]:
        lines.append(("gate now", estimate["gate"]))
    samples = max(snapshot["samples"], 1)
    shares = sorted(snapshot["gates"].items(), key=lambda item: -item[1])
    closed = ", ".join(f"{name} {100 * n / samples:.0f} %" for name, n in shares)
    learned = f"learned from {100 * snapshot['updated'] / samples:.0f} % of {snapshot['samples']:,} samples"
    lines.append(("gates", f"{learned}; {closed}" if closed else learned))
    lines.append(
        ("bus", f"{bus['interface']}:{bus['channel']} {bus['state']}, {bus['frames_per_s']:.0f} frames/s")
    )
    troubles = {k: v for k, v in bus.items() if isinstance(v, int) and v and k not in _NOT_A_FAULT}
    if troubles:
        lines.append(("bus events", _counted(troubles)))
    lines += _broadcast(node)
    if snapshot["masses_of_others_kg"]:
        lines.append(("mass by others", _masses_of_others(snapshot)))
    if snapshot["other_senders"]:
        lines.append(("unexpected", _counted(snapshot["other_senders"], 4)))
    lines += _sender_warnings(snapshot)
    lines.append(
        (
            "ticks",
            f"{ticks['count']:,}, {ticks['cpu_us_mean']:.0f} us each, {ticks['missed']:,} missed, "
            f"{100 * ticks['within_half_ms']:.1f} % within 0.5 ms",
        )
    )
    errors = {k: v for k, v in snapshot["files"].items() if isinstance(v, str)}
    lines += [(_readable(name), text) for name, text in errors.items()]
    if snapshot["failures"]:
        lines.append(
            ("failures", f"{snapshot['failures']} errors inside the estimation were survived: see the log")
        )
    if snapshot["reload_refused_because"]:
        refused = f"refused, the one before is in force: {snapshot['reload_refused_because']}"
        lines.append(("new config", refused))
    if verbose:
        lines += [(_readable(sender), _counted(values)) for sender, values in snapshot["senders"].items()]
        for name in (
            "clock",
            "transport",
            "implausible_jumps",
            "files",
            "broadcast",
            "claims",
            "torque_commands",
        ):
            lines.append((name, _counted({k: v for k, v in snapshot[name].items() if isinstance(v, int)})))
    lines.append(("up", f"{snapshot['uptime_s'] / 3600:.1f} h, pid {snapshot['pid']}, {snapshot['config']}"))
    return lines


def _broadcast(node: dict[str, Any]) -> list[tuple[str, str]]:
    """Return from where we send, or why not; and who else sends in our group meanwhile."""
    if node["silent_because"]:
        return [("broadcast", f"silent: {node['silent_because']}")]
    sends = f"on, from address {node['address']:#04x}" if node["address"] is not None else "silent"
    lines = [("broadcast", sends)]
    if others := ", ".join(f"{a:#04x}" for a in node["other_users_of_our_group"]):
        text = (
            f"also sent from {others}: receivers get both. Stop one sender, or give it another broadcast.pgn"
        )
        lines.append(("group shared", text))
    return lines


def _masses_of_others(snapshot: dict[str, Any]) -> str:
    """Return what others report, and how much more than ours that is."""
    apart_pct = snapshot["masses_of_others_pct"]
    return ", ".join(
        f"{kg:,.0f} kg from {a}" + (f" ({apart_pct[a]:+.1f} % of ours)" if a in apart_pct else "")
        for a, kg in snapshot["masses_of_others_kg"].items()
    )


def _sender_warnings(snapshot: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the signs that a sender may not be the ECU whose address it uses."""
    lines = []
    for role, refused in snapshot["contested_signals"].items():
        senders = _counted({f"from {address}": n for address, n in refused.items()}, 4)
        text = f"{role} comes from several addresses; refused: {senders}. Name the right one (source:)"
        lines.append(("contested", text))
    if stuck := snapshot.get("stuck_signals", {}):
        seconds = _counted({f"{role}, seconds:": s for role, s in stuck.items()}, 4)
        lines.append(("stuck", f"{seconds}. The vehicle changed its speed meanwhile; taken as silent"))
    for sender, (usual_hz, now_hz) in snapshot["sends_faster"].items():
        rates = f"{_readable(sender)}: {now_hz:g} Hz, usually {usual_hz:g}"
        lines.append(("too fast", f"{rates}. Does somebody else send under this address?"))
    past = {k: s for k, s in snapshot["sent_faster_s"].items() if k not in snapshot["sends_faster"]}
    if past:
        lines.append(("was too fast", _counted({f"{sender}, seconds:": s for sender, s in past.items()}, 4)))
    lost = snapshot["broadcast"].get("cannot_claim_received", 0)
    if lost:
        claims = _counted(snapshot["claims"], 8)
        claimed = f"claims: {claims}" if claims else "no claim of an address was received"
        lines.append(("addresses lost", f"{lost} times an ECU had to give its own up; {claimed}"))
    return lines


def _estimate(estimate: dict[str, Any]) -> str:
    if estimate["mass_kg"] is None:
        return "none"
    mass = f"mass {estimate['mass_kg']:,.0f} kg +- {estimate['mass_std_kg'] or 0:,.0f}"
    if estimate["grade"] is None:
        return mass
    return f"{mass}, grade {100 * estimate['grade']:+.2f} % +- {100 * (estimate['grade_std'] or 0):.2f}"


def _last_known(snapshot: dict[str, Any]) -> str:
    """Return the newest mass and its age: this run's, else the one learned before; '' without any."""
    if known := snapshot.get("last_known"):
        status, age_s = known["status"], known["age_s"]
    elif known := snapshot.get("learned"):
        status, age_s = "valid, before the start", max(0.0, time.time() - known["saved_s"])
    else:
        return ""
    return f"mass {known['mass_kg']:,.0f} kg +- {known['mass_std_kg'] or 0:,.0f}, {status}, {age(age_s)} ago"


def age(seconds: float) -> str:
    """Return a time span as a person would say it: 35 s, 12 min, 3.5 h."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _readable(key: str) -> str:
    return key.replace("_", " ").replace("pgn ", "PGN ")


def _counted(values: dict[str, Any], most: int = 50) -> str:
    shown = [f"{_readable(name)} {value}" for name, value in values.items() if value is not None]
    more = f", and {len(shown) - most} more" if len(shown) > most else ""
    return ", ".join(shown[:most]) + more
