"""What systemd takes literally: names of instances, and values of an Environment= line."""

from __future__ import annotations

import re
from pathlib import Path

from canest.core.errors import ConfigError, OutputError

#: a part of what ``systemd-escape`` leaves as it is; RUNTIME_DIRECTORY is a list with colons, and the name of
#: a socket in it has at most 107 bytes
_INSTANCE = re.compile(r"(?!.*\.\.)[A-Za-z0-9_][A-Za-z0-9_.-]{0,49}")
_SPECIAL = str.maketrans({"%": "%%", "\\": "\\\\", '"': '\\"'})


def require_instance(name: str, where: str) -> str:
    """Return a name that stands for itself in ``canest@NAME.service`` and in paths. Errors: ConfigError."""
    if not _INSTANCE.fullmatch(name):
        near = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:50]
        raise ConfigError(
            "is no name for an instance",
            where=where,
            found=name,
            expected=f"letters, digits, _ - and ., at most 50, e.g. --name {near or 'truck'}",
        )
    return name


def assignment(name: str, value: str) -> str:
    """Return ``NAME=value`` as an Environment= line takes it: quoted, without specifiers (``%``)."""
    text = f"{name}={value}"
    return f'"{text.translate(_SPECIAL)}"' if re.search(r"[^\w./:=-]", text, re.ASCII) else text


def require_folder(folder: Path) -> str:
    """Return a folder's path as PATH can name it. Errors: OutputError."""
    text = str(folder)
    if ":" in text or not text.isprintable():
        raise OutputError(
            "cannot stand in the PATH of a service", where="canest's own folder", found=text,
            expected="a path of printable characters without a colon, e.g. /opt/canest",
        )  # fmt: skip
    return text
