"""Files of a simulated drive: candump log, truth table, config."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from canest.core.frames import FloatColumn, FrameBlock
from canest.logs.candump_writer import candump_text
from canest.system.generated_files import digest, refuse_edited, stamped
from canest.system.result_files import write_results

_FORMATS = {"t_s": "%.3f", "distance_m": "%.2f", "speed_mps": "%.4f", "accel_mps2": "%.4f", "grade": "%.6f",
            "mass_kg": "%.1f", "elevation_m": "%.2f", "shift": "%d", "brake": "%d"}  # fmt: skip


def drive_paths(name: str, directory: str | Path, compress: bool) -> tuple[Path, Path, Path]:
    """Return where the log, the truth and the config of a drive go."""
    endings = (".log.xz" if compress else ".log", ".truth.csv", ".yaml")
    log, truth, config = (Path(directory) / f"{name}{ending}" for ending in endings)
    return log, truth, config


def write_drive(
    directory: Path,
    name: str,
    frames: FrameBlock,
    truth: dict[str, FloatColumn],
    config: dict[str, Any],
    *,
    compress: bool = False,
    force: bool = False,
) -> list[Path]:
    """Write NAME.log[.xz], NAME.truth.csv and NAME.yaml: all three, or none; return their paths.

    force: also over files that somebody edited. Errors: OSError, OutputError; UsageError for such a file.
    """
    directory.mkdir(parents=True, exist_ok=True)
    log, table, yaml_file = drive_paths(name, directory, compress)
    contents = {log: candump_text(frames), table: _truth_text(truth)}
    if compress:
        import lzma  # costs start-up time, and few ask for it

        contents[log] = lzma.compress(contents[log], preset=1)
    contents[yaml_file] = _config_file(config, contents)
    if not force:
        plain = config_text(config).encode()
        for path, content in contents.items():
            refuse_edited(path, content, written={digest(plain), *_written_before(yaml_file, path.name)})
    write_results(contents)
    return list(contents)


def _truth_text(truth: dict[str, FloatColumn]) -> bytes:
    names = list(_FORMATS)
    row = ",".join(_FORMATS.values())
    lines = [row % values for values in zip(*(truth[name].tolist() for name in names), strict=True)]
    return ("\n".join([",".join(names), *lines]) + "\n").encode()


def _config_file(config: dict[str, Any], others: dict[Path, bytes]) -> bytes:
    """Return the config below comments by which edits of it, and of the files beside it, are noticed."""
    beside = "".join(f"# {path.name}: sha256 {digest(content)}\n" for path, content in others.items())
    return stamped((beside + config_text(config)).encode())


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
