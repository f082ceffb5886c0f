"""Uses every public name, for mypy alone: it sees types that are exact enough to find a mistake."""

from __future__ import annotations

import canest

NAMES: tuple[object, ...] = (
    canest.BusError,
    canest.CanestError,
    canest.Comparison,
    canest.Config,
    canest.ConfigError,
    canest.Diagnosis,
    canest.Estimates,
    canest.FrameBlock,
    canest.Gate,
    canest.LogError,
    canest.OutputError,
    canest.Pipeline,
    canest.Replay,
    canest.Signals,
    canest.SimulatedDrive,
    canest.Status,
    canest.UsageError,
    canest.Vehicle,
    canest.compare,
    canest.demo_drive,
    canest.diagnose,
    canest.estimate,
    canest.estimators,
    canest.load_config,
    canest.read_signals,
    canest.replay,
    canest.simulate,
)


def use() -> float:
    """Return a mass; an unused ignore is an error of its own."""
    result: canest.Replay = canest.replay("a.log", "class8")
    canest.replay(1, "class8")  # type: ignore[arg-type]
    return float(result.mass_kg[-1])
