"""The daemon's condition in sentences: why the mass is not valid, the state of the bus, the systemd line."""

from __future__ import annotations

import math

from canest.bus.protocols import UP, bus_state
from canest.core.gates import LABELS
from canest.core.samples import STEP_S
from canest.doctor.reasons import why_no_signal
from canest.node.estimate_frame import STATUS_NAMES
from canest.pipeline.signal_timing import hold_us
from canest.telemetry.daemon_view import DaemonView

NOT_AVAILABLE = "not available"


def why_not_valid(view: DaemonView) -> str:
    """Return one sentence on what the estimate lacks ('' when it is valid)."""
    estimate, pipeline, config = view.estimate, view.pipeline, view.config
    status = STATUS_NAMES[estimate.status]
    if status == "valid":
        return ""
    if view.receiver.state not in UP:
        return f"the bus {config.bus.channel} is {bus_state(view.receiver)}"
    counters = pipeline.decoder.counters
    if not counters.frames:
        return f"no frame has been received on {config.bus.channel} yet of those that the config maps"
    if status == NOT_AVAILABLE:
        return f"quiet: no frame that the config maps for more than {hold_us(config) * 1e-6:g} s"
    missing = pipeline.estimator.missing() or why_no_signal(config, counters, counters.frames)
    if missing := missing or pipeline.estimator.contradiction():
        return missing
    gate = LABELS.get(estimate.gate, "")
    learned_s = pipeline.updated * STEP_S
    text = f"learned from {learned_s:.1f} s of driving so far"
    if estimate.mass_std_kg < estimate.mass_kg:  # neither is NaN
        std_pct = 100 * estimate.mass_std_kg / estimate.mass_kg
        text = f"+- {std_pct:.1f} %, where {100 * pipeline.estimator.valid_std:g} % is valid; {text}"
    return f"{text}; now held back by the gate {gate}" if gate else text


def status_line(view: DaemonView) -> str:
    """Return the line that ``systemctl status`` shows."""
    estimate = view.estimate
    bus = f"{view.config.bus.channel} {view.receiver.state}, {view.rates.frames_per_s:.0f} frames/s"
    status = STATUS_NAMES[estimate.status]
    if math.isnan(estimate.mass_kg):
        return f"{status}: {why_not_valid(view)} ({bus})"
    # whole hundreds and tenths: a line that changes at every update would only fill the journal
    mass = f"mass {estimate.mass_kg / 1000:.1f} t +- {estimate.mass_std_kg / 1000:.1f}"
    gate = LABELS.get(estimate.gate, "")
    return f"{status}: {mass}, grade {100 * estimate.grade:.1f} %{f', gate {gate}' if gate else ''} ({bus})"
