"""Finds the files that ship with canest (DBCs, configs, units), in a checkout or an installed wheel."""

from __future__ import annotations

from pathlib import Path

from canest.core.errors import ConfigError

_PACKAGE = Path(__file__).resolve().parent.parent


def shipped(kind: str) -> Path:
    """Return the folder of shipped files of a kind: ``dbc``, ``configs`` or ``systemd``."""
    installed = _PACKAGE / "_shipped" / kind
    return installed if installed.is_dir() else _PACKAGE.parent / kind


def find(kind: str, name: str, where: str = "") -> Path:
    """Return the file ``name``: as given, or among the shipped ones.

    where: the key that names the file. Errors: ConfigError that lists the shipped names.
    """
    for path in candidates(kind, name):
        if is_file(path):
            return path
    if any(map(_is_hidden, candidates(kind, name))):
        raise ConfigError("cannot be read: a folder above it may not be entered", where=where or name)
    names = ", ".join(sorted(p.name for p in shipped(kind).glob("*") if p.is_file()))
    what = f"{kind.removesuffix('s')} file"
    raise ConfigError(
        f"is {found}, not a {what}" if (found := _other_kind(Path(name))) else f"no such {what}",
        where=where or name,
        found=name if where else None,
        expected=f"a path or a shipped name ({names})",
    )


def candidates(kind: str, name: str) -> list[Path]:
    """Return where the file ``name`` may be, in order."""
    folder = shipped(kind)
    places = [Path(name), folder / name]
    if kind == "configs" and not name.endswith((".yaml", ".yml")):
        places.append(folder / f"{name}.yaml")
    return places


def is_file(path: Path) -> bool:
    """Return whether ``path`` is a file that can be seen."""
    try:
        return path.is_file()
    except OSError:  # a name too long, or a folder that may not be entered
        return False


def _is_hidden(path: Path) -> bool:
    try:
        path.stat()
    except PermissionError:
        return True
    except (OSError, ValueError):
        return False
    return False


def _other_kind(path: Path) -> str:
    """Return what is there in place of a file ('' for nothing). A pipe would keep its reader waiting."""
    try:
        if path.is_dir():
            return "a directory"
        return "a pipe or a device" if path.exists() else ""
    except (OSError, ValueError):  # as above
        return ""
