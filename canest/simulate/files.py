"""Writes a simulated drive: candump log, truth table, config."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from canest.logs.writer import candump_text

if TYPE_CHECKING:
    from canest.simulate.run import SimulatedDrive

_FORMATS = {"t_s": "%.3f", "distance_m": "%.2f", "speed_mps": "%.4f", "accel_mps2": "%.4f", "grade": "%.6f",
            "mass_kg": "%.1f", "elevation_m": "%.2f", "shift": "%d", "brake": "%d"}  # fmt: skip


def drive_paths(name: str, directory: str | Path, compress: bool) -> tuple[Path, Path, Path]:
    """Return where the log, the truth and the config of a drive go."""
    endings = (".log.xz" if compress else ".log", ".truth.csv", ".yaml")
    log, truth, config = (Path(directory) / f"{name}{ending}" for ending in endings)
    return log, truth, config


def write_drive(drive: SimulatedDrive, directory: Path, compress: bool) -> list[Path]:
    """Write NAME.log[.xz], NAME.truth.csv and NAME.yaml. Errors: OSError."""
    directory.mkdir(parents=True, exist_ok=True)
    log, truth, config = drive_paths(drive.name, directory, compress)
    text = candump_text(drive.frames)
    if compress:
        import lzma

        log.write_bytes(lzma.compress(text, preset=1))
    else:
        log.write_bytes(text)
    names = list(_FORMATS)
    row = ",".join(_FORMATS[name] for name in names)
    lines = [row % values for values in zip(*(drive.truth[name].tolist() for name in names), strict=True)]
    truth.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    config.write_text(config_text(drive.config), encoding="utf-8")
    return [log, truth, config]


def config_text(config: dict[str, Any]) -> str:
    """Return a config as YAML text."""
    return yaml.safe_dump(config, sort_keys=False, allow_unicode=True)
