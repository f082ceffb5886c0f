"""A short log of a truck under a pulsating throttle, with a config that fits, and what to change in that."""

from __future__ import annotations

from pathlib import Path

from canest.config import Config, load_config
from canest.simulation import simulate


def write_drive(folder: Path, seconds: int) -> Path:
    """Simulate and write it; return the log. Its config stands beside it."""
    scenario = {
        "duration_s": seconds,
        "vehicle": "class8",
        "mass_kg": 21250,
        "road": {"kind": "highway"},
        "driver": {"kind": "pulses"},
        "bus": {"traffic": False, "cab_controller": False},
    }
    return next(path for path in simulate(scenario, 1).write(folder) if path.suffix == ".log")


def config_of(drive: Path, *overrides: str, without: tuple[str, ...] = ()) -> Config:
    """Return the config of such a log, with overrides and without some roles."""
    config = load_config(str(drive.with_suffix(".yaml")), list(overrides))
    kept = {role: source for role, source in config.signals.items() if role not in without}
    return config.model_copy(update={"signals": kept})
