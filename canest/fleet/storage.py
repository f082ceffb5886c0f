"""Files wherever fsspec finds them: a folder of this machine, s3://, gs://, az://."""

from __future__ import annotations

import os
import posixpath
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from canest.core.errors import CanestError, LogError, OutputError, UsageError
from canest.fleet.packages import require
from canest.system.atomic_file import AtomicFile

T = TypeVar("T")

#: pauses between the attempts at a store that does not answer
RETRY_PAUSES_S = (0.5, 2.0, 5.0)
#: errors that stay as they are however often one asks
_FINAL = (FileNotFoundError, FileExistsError, PermissionError, IsADirectoryError, NotADirectoryError)
_LOCAL = ("", "file", "local")
#: of the packages below: without these, a store that is gone is asked a hundred times for each log
_S3 = {"config_kwargs": {"retries": {"total_max_attempts": 1, "mode": "standard"}, "connect_timeout": 10}}
_OPTIONS: dict[str, dict[str, Any]] = {"s3": _S3, "s3a": _S3}
_S3_ATTEMPTS = 2


class StoreError(LogError):
    """A store did not answer, however often it was asked."""


@dataclass(frozen=True)
class Storage:
    """A folder of a file system. protocol: "" for this machine's. root: without the protocol."""

    protocol: str
    root: str

    @staticmethod
    def of(url: str) -> Storage:
        """Return the storage of a path or URL. Errors: UsageError for one that fsspec does not know."""
        protocol, mark, rest = url.partition("://")
        if not mark or protocol in _LOCAL:
            return Storage("", str(Path(rest if mark else url).expanduser().absolute()))
        storage = Storage(protocol, rest.rstrip("/"))
        _ = storage.files
        return storage

    @property
    def is_local(self) -> bool:
        """Return whether it is on this machine."""
        return not self.protocol

    @cached_property
    def files(self) -> Any:
        """Return the fsspec file system. Errors: UsageError."""
        (fsspec,) = require("fsspec", why=f"{self.protocol or 'a file'}://")
        try:
            files = fsspec.filesystem(self.protocol or "file", **_OPTIONS.get(self.protocol, {}))
        except (ImportError, ValueError) as error:
            raise UsageError(
                f"cannot reach {self.protocol}://",
                where=f"{self.protocol}://{self.root}",
                found=str(error),
                expected="a path, s3://, or a protocol whose fsspec package is installed",
            ) from None
        if self.protocol in _OPTIONS:
            files.retries = _S3_ATTEMPTS
        return files

    def url(self, name: str = "") -> str:
        """Return the path or URL of a file below it."""
        path = posixpath.join(self.root, name) if name else self.root
        return f"{self.protocol}://{path}" if self.protocol else path

    def write(self, name: str, content: bytes) -> None:
        """Write a file below it, which is there as a whole or not at all. Errors: OutputError.

        Its content is on the disk before it has its name: a power cut leaves no empty file. `sync` waits for
        the name too.
        Two runs that write the same name at once write the same content: one of them is enough.
        """
        try:
            if not self.is_local:
                retried(lambda: self.files.pipe_file(f"{self.root}/{name}", content))
                return
            path = Path(self.root, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            result = AtomicFile(path)
            try:
                result.file.write(content)
                result.file.flush()
                os.fsync(result.file.fileno())
            except BaseException:
                result.discard()
                raise
            with suppress(FileExistsError):
                result.commit()
        except Exception as error:
            raise OutputError(f"cannot write: {plain(error)}", where=self.url(name)) from None

    def sync(self, folder: str) -> None:
        """Wait until the names in a folder below it are on the disk. Errors: OutputError."""
        if not self.is_local:  # a store has what it has taken
            return
        try:
            descriptor = os.open(Path(self.root, folder), os.O_RDONLY | os.O_DIRECTORY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise OutputError(f"cannot be synced: {plain(error)}", where=self.url(folder)) from None

    def read(self, name: str) -> bytes:
        """Return the content of a file below it. Errors: CanestError."""
        try:
            content: bytes = retried(lambda: self.files.cat_file(f"{self.root}/{name}"))
        except Exception as error:
            raise CanestError(f"cannot read: {plain(error)}", where=self.url(name)) from None
        return content

    def read_if_there(self, name: str) -> bytes | None:
        """Return the content of a file below it, None where somebody has removed it. Errors: CanestError."""
        try:
            return self.read(name)
        except CanestError:
            if self.exists(name):
                raise
            return None

    def remove(self, name: str) -> None:
        """Remove a file below it, if it is there. Errors: OutputError."""
        try:
            retried(lambda: self.files.rm_file(f"{self.root}/{name}"))
        except FileNotFoundError:
            pass
        except Exception as error:
            raise OutputError(f"cannot remove: {plain(error)}", where=self.url(name)) from None

    def names(self, folder: str) -> list[str]:
        """Return the files in a folder below it at any depth, in order; none where there is no folder.

        Errors: CanestError.
        """
        return sorted(_names_here(Path(self.root), folder) if self.is_local else self._found(folder))

    def sizes(self, folder: str) -> dict[str, int]:
        """Return the files in a folder below it, as `names` does, with their sizes in bytes."""
        if not self.is_local:
            found = self._found(folder)
            return {name: int(found[name].get("size") or 0) for name in sorted(found)}
        sizes = {}
        for name in self.names(folder):
            with suppress(FileNotFoundError):
                sizes[name] = Path(self.root, name).stat().st_size
        return sizes

    def exists(self, name: str) -> bool:
        """Return whether a file below it is there. Errors: CanestError."""
        try:
            self.files.invalidate_cache()
            return bool(retried(lambda: self.files.exists(f"{self.root}/{name}")))
        except Exception as error:
            raise CanestError(f"cannot be reached: {plain(error)}", where=self.url(name)) from None

    def _found(self, folder: str) -> dict[str, Any]:
        try:
            self.files.invalidate_cache()
            found = retried(lambda: self.files.find(f"{self.root}/{folder}", detail=True))
        except FileNotFoundError:
            return {}
        except Exception as error:
            raise CanestError(f"cannot list: {plain(error)}", where=self.url(folder)) from None
        below = posixpath.normpath(self.root) + "/"
        return {path[path.index(below) + len(below) :]: info for path, info in found.items()}


def _names_here(root: Path, folder: str) -> Iterator[str]:
    """Yield the files in a folder of this machine, below a root. Errors: CanestError."""

    def refuse(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):  # a folder may go while it is looked for
            raise CanestError(f"cannot list: {plain(error)}", where=str(root / folder)) from None

    # fsspec asks for the size and times of every file: some hundred times the cost
    for place, _, files in os.walk(root / folder, onerror=refuse):
        below = Path(place).relative_to(root).as_posix()
        yield from (f"{below}/{name}" if below != "." else name for name in files)


def download(url: str, folder: Path) -> Path:
    """Return a copy of a log in a folder of this machine, under its own name. Errors: LogError."""
    storage = Storage.of(posixpath.dirname(url))
    path = folder / (posixpath.basename(url) or "log")
    try:
        retried(lambda: storage.files.get_file(f"{storage.root}/{posixpath.basename(url)}", str(path)))
    except _FINAL as error:
        raise LogError(f"cannot be fetched: {plain(error)}", where=url) from None
    except Exception as error:
        raise StoreError(f"cannot be fetched: {plain(error)}", where=url) from None
    return path


def retried(action: Callable[[], T]) -> T:
    """Return what an action returns; where its store does not answer, it is tried some times more."""
    for pause_s in RETRY_PAUSES_S:
        try:
            return action()
        except _FINAL:
            raise
        except Exception:
            time.sleep(pause_s)
    return action()


def plain(error: Exception) -> str:
    """Return an error's text in one line."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())[:300]
