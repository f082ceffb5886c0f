"""Results never replace what they were made from, nor one another."""

from __future__ import annotations

import os
import stat
from collections.abc import Hashable, Iterable
from pathlib import Path

from canest.core.errors import UsageError
from canest.system.atomic_file import require_regular

Named = tuple[str, Path | str | None]  #: an option or argument, and the file it names


def keep_apart(inputs: Iterable[Named], outputs: Iterable[Named]) -> None:
    """Refuse outputs that are an input or another output, by whatever name (links too).

    Errors: UsageError. Devices and pipes ('-', /dev/stdout) may be named as often as one likes; a file that
    stdout leads to may not.
    """
    taken: dict[Hashable, str] = {
        _identity(Path(path)): name for name, path in inputs if path is not None and Path(path).is_file()
    }
    for name, path in outputs:
        if path is None or (key := _identity(Path(path))) is None:
            continue
        if key in taken:
            what = f"would overwrite {taken[key]}"
            raise UsageError(what, where=name, found=str(path), expected="another name or directory")
        taken[key] = name


def require_files(outputs: Iterable[Named]) -> None:
    """Refuse names of what exists and is no file: a FIFO would wait for its reader. Errors: UsageError."""
    for name, path in outputs:
        try:
            if path is not None:
                require_regular(Path(path))
        except OSError as error:
            raise UsageError(f"{path} {error.strerror or error}", where=name) from None


def require_writable(outputs: Iterable[tuple[str, Path]]) -> None:
    """Refuse files that this user may not write, or whose directory it may not make. Errors: UsageError.

    A full disk is no reason: it may have room later. Stands below `require_files`.
    """
    for name, path in outputs:
        there = next(place for place in (path, *path.parents) if place.exists())
        if not os.access(there, os.W_OK | os.X_OK if there.is_dir() else os.W_OK):
            where, expected = f"{name}: {path}", f"permission to write {there}"
            raise UsageError("cannot be written", where=where, expected=expected)


def is_stdout(path: Path | str | None) -> bool:
    """Return whether what is written to a file goes where stdout goes."""
    try:
        return path is not None and (str(path) == "-" or os.path.samestat(Path(path).stat(), os.fstat(1)))
    except OSError:
        return False


def _identity(path: Path) -> Hashable | None:
    """Return what identifies a file ('-': that which stdout leads to), None for what is no file."""
    try:
        found = os.fstat(1) if str(path) == "-" else path.stat()
    except OSError:
        return path.resolve()
    return (found.st_dev, found.st_ino) if stat.S_ISREG(found.st_mode) else None
