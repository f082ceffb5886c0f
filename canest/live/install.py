"""Puts the systemd unit and a config where systemd looks for them."""

from __future__ import annotations

import shlex
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from canest.bus.sandbox import DROP_IN, drop_in
from canest.config.load import parse_config
from canest.core.errors import CanestError, ConfigError, OutputError
from canest.live.unit_syntax import assignment, require_folder, require_instance
from canest.system.files import write_atomically
from canest.system.generated_files import refuse_edited, stamped
from canest.system.shipped_files import find, is_file, shipped

UNIT = "canest@.service"
_PATH_LINE = "Environment=PATH="
#: DynamicUser= runs the service as a user who owns none of its files
_FILE_MODE, _FOLDER_MODE = 0o644, 0o755
_HOMES = ("/home", "/root", "/run/user")


@dataclass(slots=True)
class Installed:
    """What was written, and notes and next steps for the user."""

    written: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    config: Path | None = None  #: as the service will read it


def unit_text(executable: Path | None = None) -> str:
    """Return the unit; its PATH begins with the directory of this canest, wherever that is installed.

    Errors: OutputError where that directory cannot stand in a PATH.
    """
    text = (shipped("systemd") / UNIT).read_text(encoding="utf-8")
    folder = require_folder((executable or this_executable()).parent)
    lines = []
    for line in text.splitlines():
        if line.startswith(_PATH_LINE):
            folders = line.removeprefix(_PATH_LINE).split(":")
            path = ":".join([folder, *(f for f in folders if f != folder)])
            line = f"Environment={assignment('PATH', path)}"
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
    *,
    force: bool = False,
) -> Installed:
    """Write the unit below ``root``, and the config as the instance ``name`` (default: the file's name).

    databases: the DBC files that go along (`databases_of`). Configs and DBC files that exist are kept;
    a unit that somebody edited is refused, unless `force`. Errors: ConfigError, OutputError, UsageError.
    """
    done = Installed()
    executable = this_executable()
    if any(executable.is_relative_to(home) for home in _HOMES):
        done.notes.append(
            f"canest is installed in {executable.parent}, which the unit's ProtectHome=yes hides: "
            "install it in /opt/canest (python3 -m venv /opt/canest && /opt/canest/bin/pip install CLONE)"
        )
    unit = root / "etc/systemd/system" / UNIT
    instance = None
    if name is not None:
        instance = require_instance(name, "--name")
    elif config is not None:
        instance = require_instance(config.stem, str(config))
    try:
        content = stamped(unit_text(executable).encode())
        if not force:
            refuse_edited(unit, content)
        _write(unit, content, done)
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
            _allow_network(unit.with_name(f"canest@{instance}.service.d") / DROP_IN, done)
            _note_unreadable([unit, done.config, *(folder / n for n in databases)], root, done)
    except OSError as error:
        raise OutputError(
            f"cannot be written ({error.strerror})",
            where=str(error.filename or unit),
            expected="root: sudo" if isinstance(error, PermissionError) else "",
        ) from error
    if root == Path("/"):
        _reload_systemd(done)
    shown = instance or "NAME"
    if instance is None:
        done.notes.append("next: put a config at /etc/canest/NAME.yaml")
    done.notes.append(f"next: systemctl enable --now canest@{shown}, then canest status")
    return done


def _allow_network(path: Path, done: Installed) -> None:
    """Write the drop-in that the config in force needs, beside what else lies there."""
    try:
        config = parse_config(done.config.read_text(encoding="utf-8")) if done.config is not None else None
        content = None if config is None else drop_in(config)
    except (CanestError, UnicodeDecodeError):
        return  # an older config that is refused: the command reports so
    there = path.read_text(encoding="utf-8", errors="replace") if path.exists() else None
    if there is not None and there != content:
        needed = "uses no network" if content is None else f"needs {', '.join(content.splitlines()[2:])}"
        done.notes.append(f"{path} exists and was kept: the config {needed}")
    elif content is not None and there is None:
        _write(path, content.encode(), done)


def _write(path: Path, content: bytes, done: Installed) -> None:
    """Write a file that the service's own user can read, whatever the umask."""
    for folder in reversed([f for f in path.parents if not f.exists()]):
        folder.mkdir()
        folder.chmod(_FOLDER_MODE)
    write_atomically(path, content)  # mode 0644
    done.written.append(path)


def _note_unreadable(files: Iterable[Path], root: Path, done: Installed) -> None:
    """Note what was there before such that the service's own user cannot read it."""
    folders = {f for file in files for f in file.parents if f.is_relative_to(root) and f != root}
    for path in (*sorted(folders), *files):
        needed = (_FOLDER_MODE if path.is_dir() else _FILE_MODE) & stat.S_IRWXO
        if path.stat().st_mode & needed != needed:
            change = "a+rx" if path.is_dir() else "a+r"
            done.notes.append(f"the service cannot read {path}: chmod {change} {shlex.quote(str(path))}")


def _reload_systemd(done: Installed) -> None:
    systemctl = shutil.which("systemctl")
    if systemctl is None:
        done.notes.append("this machine has no systemctl: the unit is only written")
        return
    result = subprocess.run([systemctl, "daemon-reload"], capture_output=True, text=True, check=False)
    if result.returncode:
        done.notes.append(f"systemctl daemon-reload: {result.stderr.strip() or result.returncode}")
