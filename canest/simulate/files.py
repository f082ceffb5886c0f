"""Writes a simulated drive: candump log, truth table, config."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from canest.generated import digest, refuse_edited, stamped
from canest.logs.writer import candump_text
from canest.results import write_results

if TYPE_CHECKING:
    from canest.simulate.run import SimulatedDrive

_FORMATS = {"t_s": "%.3f", "distance_m": "%.2f", "speed_mps": "%.4f", "accel_mps2": "%.4f", "grade": "%.6f",
            "mass_kg": "%.1f", "elevation_m": "%.2f", "shift": "%d", "brake": "%d"}  # fmt: skip


def drive_paths(name: str, directory: str | Path, compress: bool) -> tuple[Path, Path, Path]:
    """Return where the log, the truth and the config of a drive go."""
    endings = (".log.xz" if compress else ".log", ".truth.csv", ".yaml")
    log, truth, config = (Path(directory) / f"{name}{ending}" for ending in endings)
    return log, truth, config


def write_drive(drive: SimulatedDrive, directory: Path, compress: bool, force: bool = False) -> list[Path]:
    """Write NAME.log[.xz], NAME.truth.csv and NAME.yaml: all three, or none.

    force: also over files that somebody edited. Errors: OSError, OutputError; UsageError for such a file.
    """
    directory.mkdir(parents=True, exist_ok=True)
    log, truth, config = drive_paths(drive.name, directory, compress)
    contents = {log: candump_text(drive.frames), truth: _truth_text(drive)}
    if compress:
        import lzma

        contents[log] = lzma.compress(contents[log], preset=1)
    contents[config] = _config_file(drive, contents)
    if not force:
        plain = config_text(drive.config).encode()
        for path, content in contents.items():
            refuse_edited(path, content, written={digest(plain), *_written_before(config, path.name)})
    write_results(contents)
    return list(contents)


def _truth_text(drive: SimulatedDrive) -> bytes:
    names = list(_FORMATS)
    row = ",".join(_FORMATS[name] for name in names)
    lines = [row % values for values in zip(*(drive.truth[name].tolist() for name in names), strict=True)]
    return ("\n".join([",".join(names), *lines]) + "\n").encode()


def _config_file(drive: SimulatedDrive, others: dict[Path, bytes]) -> bytes:
    """Return the config below comments by which edits of it, and of the files beside it, are noticed."""
    beside = "".join(f"# {path.name}: sha256 {digest(content)}\n" for path, content in others.items())
    return stamped((beside + config_text(drive.config)).encode())


def _written_before(config: Path, name: str) -> list[str]:
    """Return the digest of a file as the config of an earlier simulation has it."""
    try:
        content = config.read_bytes()
    except OSError:
        return []
    pattern = rb"^# %s: sha256 ([0-9a-f]{64})$" % re.escape(name).encode()
    return [found.decode() for found in re.findall(pattern, content, re.MULTILINE)]


def config_text(config: dict[str, Any]) -> str:
    """Return a config as YAML text."""
    return yaml.safe_dump(config, sort_keys=False, allow_unicode=True)
