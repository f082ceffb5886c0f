"""The parts of a running daemon that status, metrics and the log report on.

The daemon hands them over in one frozen `DaemonView`, so that telemetry does not depend on the daemon itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from canest.bus.protocols import Receiver
from canest.config.schema import Config
from canest.node.estimate_frame import Estimate
from canest.node.node import Node
from canest.pipeline.pipeline import Pipeline
from canest.system.files import Background
from canest.telemetry.loop_rates import LoopRates
from canest.telemetry.sender_rates import SenderRateMonitor


class TickCounts(NamedTuple):
    """Ticks of the 20 ms schedule: those that ran, those that were missed, the share within 0.5 ms."""

    ran: int
    missed: int
    within_half_ms: float


class ReloadCounts(NamedTuple):
    """Configs read again: accepted, refused, and why the newest one was refused ('' when accepted)."""

    accepted: int
    refused: int
    refused_because: str


class LearnedMass(NamedTuple):
    """The mass that a restart would begin from.

    saved_s: UTC, seconds since 1970. distance_km: odometer, None where the bus has none.
    """

    mass_kg: float
    mass_std_kg: float
    saved_s: float
    distance_km: float | None


class LastEstimate(NamedTuple):
    """The newest estimate that had a mass, and its age in seconds."""

    estimate: Estimate
    age_s: float


@dataclass(frozen=True, slots=True)
class DaemonView:
    """A daemon at ``now_us`` (microseconds of the monotonic clock).

    estimate: the newest one, "not available" when it is not of now. late_frames: received after their tick.
    failures: errors inside the estimation that were survived. learned: None while no mass was valid.
    last: None while there was no mass. quiet_s: since the last frame, seconds; None while there was none.
    notes: what on the bus contradicts the config. notes_logged: the same as the journal has it.
    """

    now_us: int
    started_us: int
    pid: int
    config: Config
    config_name: str
    estimate: Estimate
    pipeline: Pipeline
    receiver: Receiver
    node: Node
    background: Background
    rates: LoopRates
    sender_rates: SenderRateMonitor
    ticks: TickCounts
    reloads: ReloadCounts
    late_frames: int
    failures: int
    learned: LearnedMass | None
    last: LastEstimate | None
    quiet_s: float | None
    notes: list[str]
    notes_logged: str
