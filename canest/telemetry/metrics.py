"""The snapshot as Prometheus metrics: a text file for node_exporter, or HTTP with the extra ``metrics``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from canest.core.errors import UsageError
from canest.node.estimate_frame import STATUS_NAMES
from canest.system.installation import how_to_add

Sample = tuple[str, dict[str, str], float]

#: metric -> (type, help); names carry base units as Prometheus wants them
METRICS: dict[str, tuple[str, str]] = {
    "canest_mass_kilograms": ("gauge", "Estimated gross mass."),
    "canest_mass_std_kilograms": ("gauge", "Standard deviation of the estimated mass."),
    "canest_grade_ratio": ("gauge", "Estimated road grade, rise over run."),
    "canest_grade_std_ratio": ("gauge", "Standard deviation of the estimated grade."),
    "canest_last_mass_kilograms": ("gauge", "Newest mass there was, however old."),
    "canest_last_mass_age_seconds": ("gauge", "Age of canest_last_mass_kilograms."),
    "canest_status": ("gauge", "1 for the present status of the estimate."),
    "canest_bus_up": ("gauge", "1 while the interface works."),
    "canest_bus_frames_total": ("counter", "Frames received."),
    "canest_bus_events_total": ("counter", "What happened to the interface."),
    "canest_samples_total": ("counter", "50 Hz samples by gate; gate open: the estimator learned."),
    "canest_other_sender_frames_total": ("counter", "Frames of wanted groups from unexpected addresses."),
    "canest_contested_samples_total": ("counter", "Samples refused: another address owns the signal."),
    "canest_sender_faster_seconds_total": ("counter", "For how long a sender was much faster than usual."),
    "canest_address_claims_total": ("counter", "Claims of an address (PGN 60928)."),
    "canest_torque_commands_total": ("counter", "Engine and retarder commands (TSC1) by sender."),
    "canest_implausible_jumps_total": ("counter", "Samples refused: no vehicle changes so fast."),
    "canest_frozen_seconds_total": ("counter", "Deprecated: canest_stuck_seconds_total."),
    "canest_stuck_seconds_total": ("counter", "For how long a sensor was stuck, and taken as silent."),
    "canest_other_mass_kilograms": ("gauge", "Gross mass that another ECU sends (SPN 1760)."),
    "canest_node_events_total": ("counter", "What was sent, and what happened to us as a node."),
    "canest_clock_events_total": ("counter", "Irregular time stamps."),
    "canest_file_events_total": ("counter", "Files written, failed and refused."),
    "canest_ticks_total": ("counter", "Ticks of 20 ms on which it woke."),
    "canest_ticks_missed_total": ("counter", "Ticks that did not happen in time."),
    "canest_tick_cpu_seconds": ("gauge", "CPU time of a tick, mean of the last seconds."),
    "canest_failures_total": ("counter", "Errors inside the estimation that were survived."),
    "canest_reloads_total": ("counter", "Configs that were read again and taken over."),
    "canest_reloads_refused_total": ("counter", "Configs that were read again and refused."),
    "canest_config_refused": ("gauge", "1 while the newest config was refused and the one before works."),
    "canest_uptime_seconds": ("gauge", "Time since the start."),
}


def samples(snapshot: dict[str, Any]) -> Iterator[Sample]:
    """Yield (metric, labels, value) of a snapshot."""
    estimate, bus, ticks = snapshot["estimate"], snapshot["bus"], snapshot["ticks"]
    for metric, key in (
        ("canest_mass_kilograms", "mass_kg"),
        ("canest_mass_std_kilograms", "mass_std_kg"),
        ("canest_grade_ratio", "grade"),
        ("canest_grade_std_ratio", "grade_std"),
    ):
        yield metric, {}, math.nan if estimate[key] is None else estimate[key]
    if last := snapshot.get("last_known"):
        yield "canest_last_mass_kilograms", {}, last["mass_kg"]
        yield "canest_last_mass_age_seconds", {}, last["age_s"]
    for status in STATUS_NAMES:
        yield "canest_status", {"status": status}, float(estimate["status"] == status)
    yield "canest_bus_up", {}, float(bus["state"] in ("up", "error-passive"))
    yield "canest_bus_frames_total", {}, bus["frames"]
    known = {"interface", "channel", "state", "reason", "frames_per_s", "quiet_s", "frames", "wanted"}
    for event, count in bus.items():
        if event not in known:
            yield "canest_bus_events_total", {"event": event}, count
    yield "canest_samples_total", {"gate": "open"}, snapshot["updated"]
    for gate, count in snapshot["gates"].items():
        yield "canest_samples_total", {"gate": gate}, count
    for sender, count in snapshot["other_senders"].items():
        yield "canest_other_sender_frames_total", {"sender": sender}, count
    for signal, refused in snapshot["contested_signals"].items():
        for source, count in refused.items():
            yield "canest_contested_samples_total", {"signal": signal, "source": source}, count
    for sender, count in snapshot["sent_faster_s"].items():
        yield "canest_sender_faster_seconds_total", {"sender": sender}, count
    for source, count in snapshot["claims"].items():
        yield "canest_address_claims_total", {"source": source}, count
    for source, count in snapshot["torque_commands"].items():
        yield "canest_torque_commands_total", {"source": source}, count
    for signal, count in snapshot["implausible_jumps"].items():
        yield "canest_implausible_jumps_total", {"signal": signal}, count
    for metric in ("canest_stuck_seconds_total", "canest_frozen_seconds_total"):  # the second is deprecated
        for signal, seconds in snapshot["stuck_signals"].items():
            yield metric, {"signal": signal}, seconds
    for source, mass_kg in snapshot["masses_of_others_kg"].items():
        yield "canest_other_mass_kilograms", {"source": source}, mass_kg
    for event, count in snapshot["broadcast"].items():
        if event not in ("address", "silent_because", "other_users_of_our_group"):
            yield "canest_node_events_total", {"event": event}, count
    for event, count in snapshot["clock"].items():
        yield "canest_clock_events_total", {"event": event}, count
    for event, count in snapshot["files"].items():
        if not event.endswith("_error"):
            yield "canest_file_events_total", {"event": event}, count
    yield "canest_ticks_total", {}, ticks["count"]
    yield "canest_ticks_missed_total", {}, ticks["missed"]
    yield "canest_tick_cpu_seconds", {}, ticks["cpu_us_mean"] * 1e-6
    yield "canest_failures_total", {}, snapshot["failures"]
    yield "canest_reloads_total", {}, snapshot["reloads"]
    yield "canest_reloads_refused_total", {}, snapshot["reloads_refused"]
    yield "canest_config_refused", {}, float(bool(snapshot["reload_refused_because"]))
    yield "canest_uptime_seconds", {}, snapshot["uptime_s"]


def text(snapshot: dict[str, Any]) -> str:
    """Return the exposition text."""
    lines: list[str] = []
    described: set[str] = set()
    for metric, labels, value in samples(snapshot):
        if metric not in described:
            described.add(metric)
            kind, about = METRICS[metric]
            lines += [f"# HELP {metric} {about}", f"# TYPE {metric} {kind}"]
        inside = ",".join(f'{k}="{_escaped(v)}"' for k, v in labels.items())
        lines.append(f"{metric}{{{inside}}} {_value(value)}" if inside else f"{metric} {_value(value)}")
    return "\n".join(lines) + "\n"


class MetricsServer:
    """Serves ``latest`` (a dictionary that the daemon keeps up to date) over HTTP on this machine.

    Errors: UsageError without the extra ``metrics``, OSError when the port is taken.
    """

    def __init__(self, port: int, latest: dict[str, Any]) -> None:
        try:
            from prometheus_client import CollectorRegistry, make_wsgi_app
            from prometheus_client.core import Metric
        except ImportError:
            raise UsageError(
                "service.metrics_port needs prometheus-client", expected=how_to_add("metrics")
            ) from None
        from canest.telemetry.metrics_http import HttpServer

        class _Collector:
            def collect(self) -> Iterator[Any]:
                families: dict[str, Any] = {}
                for name, labels, value in samples(dict(latest)) if latest else ():
                    if name not in families:
                        kind, about = METRICS[name]
                        families[name] = Metric(name.removesuffix("_total"), about, kind)
                    families[name].add_sample(name, labels, value)
                yield from families.values()

        registry = CollectorRegistry()
        registry.register(_Collector())
        self.port = port
        self._server = HttpServer(port, make_wsgi_app(registry))

    def close(self) -> None:
        """Stop serving and free the port; takes up to half a second."""
        self._server.close()


def _value(value: float) -> str:
    return "NaN" if isinstance(value, float) and math.isnan(value) else repr(value)


def _escaped(label: str) -> str:
    return label.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
