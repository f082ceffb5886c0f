"""What a user named for a result: a file that appears when it is complete, or a pipe or device."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Protocol

from canest.core.errors import OutputError
from canest.system.atomic_file import AtomicFile

_LINKS_FOLLOWED = 8


class ResultFile(Protocol):
    """What results are written into: a file that appears when it is complete, or a stream."""

    file: BinaryIO

    def commit(self) -> None:
        """Complete it. Errors: OSError, after which nothing is left."""

    def discard(self) -> None:
        """Let go of it, and of what was written."""


class Stream:
    """A pipe or device (/dev/stdout, /dev/null), written as it stands. Errors: OSError."""

    def __init__(self, path: Path) -> None:
        # appended to: /dev/stdout may lead to a file, whose content before us is not ours
        self.file: BinaryIO = os.fdopen(os.open(path, os.O_WRONLY | os.O_APPEND), "wb")

    def commit(self) -> None:
        """Bring the rest to the reader."""
        self.file.close()

    def discard(self) -> None:
        """Stop writing."""
        with suppress(OSError):
            self.file.close()


def open_result(path: Path) -> ResultFile:
    """Open what a user named for a result: a file, or a pipe or device. Errors: OSError."""
    special = path.exists() and not (path.is_file() or path.is_dir())
    return Stream(path) if special or _is_open_already(path) else AtomicFile(path)


def utf8(text: str) -> bytes:
    r"""Return text as UTF-8. A byte of a file's name that is none is written as Python does: \udcff.

    JSON, YAML and a terminal's output have it the same way.
    """
    return text.encode("utf-8", "backslashreplace")


def write_results(contents: Mapping[Path, str | bytes]) -> None:
    """Write files (text as `utf8`) of which all appear, or (disk full, no permission) none.

    Errors: OutputError.
    """
    results: dict[Path, ResultFile] = {}
    try:
        for path, content in contents.items():
            with output_errors(path):
                results[path] = open_result(path)
                results[path].file.write(utf8(content) if isinstance(content, str) else content)
                results[path].file.flush()
        for path, result in results.items():
            with output_errors(path):
                result.commit()
    except BaseException:
        for result in results.values():
            result.discard()
        raise


def write_result(path: str | Path, content: str | bytes) -> None:
    """Write one file (text as `utf8`). Errors: OutputError."""
    write_results({Path(path): content})


@contextmanager
def output_errors(path: str | Path) -> Iterator[None]:
    """Turn the system's errors about a result into one line. Errors: OutputError."""
    try:
        yield
    except OSError as error:
        folder = Path(path).parent
        absent = isinstance(error, FileNotFoundError) and not folder.is_dir()
        raise OutputError(
            f"cannot write: {error.strerror or error}",
            where=str(path),
            expected=f"a directory that exists: mkdir -p {folder}" if absent else "",
        ) from None


def _is_open_already(path: Path) -> bool:
    """Return whether a name leads to a descriptor of a process: /dev/stdout, /dev/fd/3, whatever it is."""
    here = path
    for _ in range(_LINKS_FOLLOWED):
        if here.parent.resolve().is_relative_to("/proc"):
            return True
        if not here.is_symlink():
            return False
        here = here.parent / here.readlink()
    return False
