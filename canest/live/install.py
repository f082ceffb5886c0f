"""Puts the systemd unit and a config where systemd looks for them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from canest.errors import ConfigError, OutputError
from canest.resources import shipped

UNIT = "canest@.service"
_PATH_LINE = "Environment=PATH="
_HOMES = ("/home", "/root", "/run/user")


@dataclass(slots=True)
class Installed:
    """What was written, and what the user should know or do next."""

    written: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def unit_text(executable: Path | None = None) -> str:
    """Return the unit; its PATH begins with the directory of this canest, wherever that is installed."""
    text = (shipped("systemd") / UNIT).read_text(encoding="utf-8")
    folder = (executable or this_executable()).parent
    lines = []
    for line in text.splitlines():
        if line.startswith(_PATH_LINE):
            folders = line.removeprefix(_PATH_LINE).split(":")
            line = _PATH_LINE + ":".join([str(folder), *(f for f in folders if f != str(folder))])
        lines.append(line)
    return "\n".join(lines) + "\n"


def this_executable() -> Path:
    """Return the `canest` command that belongs to the running interpreter."""
    beside = Path(sys.executable).with_name("canest")
    if beside.exists():
        return beside
    found = shutil.which("canest")
    return Path(found) if found else beside


def install(
    config: Path | None, name: str | None, root: Path = Path("/"), databases: Iterable[Path] = ()
) -> Installed:
    """Write the unit below ``root``, and the config as the instance ``name`` (default: the file's name).

    databases: DBC files that lie beside the config, and shall again. Files that exist are kept.
    Errors: ConfigError, OutputError.
    """
    done = Installed()
    executable = this_executable()
    if str(executable).startswith(_HOMES):
        done.notes.append(
            f"canest is installed in {executable.parent}, which the unit's ProtectHome=yes hides: "
            "install it in /opt/canest (python3 -m venv /opt/canest && /opt/canest/bin/pip install CLONE)"
        )
    unit = root / "etc/systemd/system" / UNIT
    instance = name or (config.stem if config is not None else None)
    if instance is not None and ("/" in instance or not instance.isprintable() or " " in instance):
        raise ConfigError("is no name for an instance", where="--name", found=instance, expected="e.g. truck")
    try:
        _write(unit, unit_text(executable).encode(), done)
        if config is not None:
            folder = root / "etc/canest"
            for source, file in ((config, f"{instance}.yaml"), *((d, d.name) for d in databases)):
                if (folder / file).exists():
                    done.notes.append(
                        f"{folder / file} exists and was kept: edit it there, or remove it first; "
                        "then systemctl reload"
                    )
                else:
                    _write(folder / file, source.read_bytes(), done)
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror})", where=str(error.filename or unit), expected="root: sudo"
        ) from error
    if root == Path("/"):
        _reload_systemd(done)
    shown = instance or "NAME"
    if instance is None:
        done.notes.append("next: put a config at /etc/canest/NAME.yaml")
    done.notes.append(f"next: systemctl enable --now canest@{shown}, then canest status")
    return done


def _write(path: Path, content: bytes, done: Installed) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    done.written.append(path)


def _reload_systemd(done: Installed) -> None:
    systemctl = shutil.which("systemctl")
    if systemctl is None:
        done.notes.append("this machine has no systemctl: the unit is only written")
        return
    result = subprocess.run([systemctl, "daemon-reload"], capture_output=True, text=True, check=False)
    if result.returncode:
        done.notes.append(f"systemctl daemon-reload: {result.stderr.strip() or result.returncode}")
