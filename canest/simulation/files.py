"""Files of a simulated drive: candump log, truth table, config."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from canest.frames import FloatColumn, FrameBlock
from canest.logs.writer import candump_text

_FORMATS = {"t_s": "%.3f", "distance_m": "%.2f", "speed_mps": "%.4f", "accel_mps2": "%.4f", "grade": "%.6f",
            "mass_kg": "%.1f", "elevation_m": "%.2f", "shift": "%d", "brake": "%d"}  # fmt: skip


def drive_paths(name: str, directory: str | Path, compress: bool) -> tuple[Path, Path, Path]:
    """Return where the log, the truth and the config of a drive go."""
    endings = (".log.xz" if compress else ".log", ".truth.csv", ".yaml")
    log, truth, config = (Path(directory) / f"{name}{ending}" for ending in endings)
    return log, truth, config


def write_log(frames: FrameBlock, path: Path, compress: bool) -> None:
    """Write frames as a candump log, or compressed. Errors: OSError."""
    text = candump_text(frames)
    if compress:
        import lzma  # costs start-up time, and few ask for it

        text = lzma.compress(text, preset=1)
    path.write_bytes(text)


def write_truth(truth: dict[str, FloatColumn], path: Path) -> None:
    """Write the columns of a truth as CSV. Errors: OSError."""
    names = list(_FORMATS)
    row = ",".join(_FORMATS.values())
    lines = [row % values for values in zip(*(truth[name].tolist() for name in names), strict=True)]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")


def write_config(config: dict[str, Any], path: Path) -> None:
    """Write a config as YAML. Errors: OSError."""
    path.write_text(config_text(config), encoding="utf-8")


def config_text(config: dict[str, Any]) -> str:
    """Return a config as YAML text."""
    return yaml.safe_dump(config, sort_keys=False, allow_unicode=True)
