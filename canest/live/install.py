"""Puts the systemd unit and a config where systemd looks for them."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from canest.config.load import parse_config
from canest.core.errors import ConfigError, OutputError
from canest.system.shipped_files import find, is_file, shipped

UNIT = "canest@.service"
_PATH_LINE = "Environment=PATH="
_HOMES = ("/home", "/root", "/run/user")


@dataclass(slots=True)
class Installed:
    """What was written, and what the user should know or do next."""

    written: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    config: Path | None = None  #: as the service will read it


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


def databases_of(config: Path) -> dict[str, Path]:
    """Return the DBC files that must go along with a config, by the names it gives them.

    Shipped ones and absolute paths are found from anywhere.
    Errors: ConfigError for one that would lie outside the folder of the services.
    """
    databases = {}
    for name in parse_config(config.read_text(encoding="utf-8"), str(config)).dbc:
        beside = config.parent / name
        file = beside if is_file(beside) else find("dbc", name, str(config))
        if Path(name).is_absolute() or file == shipped("dbc") / name:
            continue
        if ".." in Path(name).parts:
            raise ConfigError(
                "lies outside the config's folder",
                where=f"{config}: dbc",
                found=name,
                expected="an absolute path",
            )
        databases[name] = file
    return databases


def install(
    config: Path | None,
    name: str | None,
    root: Path = Path("/"),
    databases: Mapping[str, Path] = MappingProxyType({}),
) -> Installed:
    """Write the unit below ``root``, and the config as the instance ``name`` (default: the file's name).

    databases: the DBC files that go along (`databases_of`). Files that exist are kept.
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
            done.config = folder / f"{instance}.yaml"
            for source, file in ((config, done.config.name), *((d, n) for n, d in databases.items())):
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
