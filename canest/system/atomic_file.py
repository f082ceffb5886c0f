"""Files that are complete or not there at all: every file that canest writes as a whole is written here.

The content grows in a temporary file of its own in the same directory, which takes the name only when it is
complete. A lock marks a temporary as long as its writer lives, on every kind of end of it; what a killed
process left is removed by the next one that writes into the same directory.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import stat
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

_TEMPORARY = re.compile(r"\..*\.canest-[0-9a-f]{16}\.part", re.DOTALL)
_NAME_SHARE = 200  #: bytes of a temporary's name that its file's name may take (255 in all on every system)
_ATTEMPTS = 10  #: at a name and lock of our own
_LONGEST_WAIT_S = 1.0  #: for others who put files into the same directory

Identity = tuple[int, int, int, int]  #: device, inode, time of the last change (ns), size

_unfinished: set[AtomicFile] = set()
_cleaned: set[tuple[int, int]] = set()  #: directories (device, inode) that this process has looked through
_sets = threading.Lock()


class AtomicFile:
    """A file that takes its name on `commit`, over an older file of that name (a link is replaced itself).

    Of two that write the same name at the same time, the later one to commit fails.
    mode: permissions; those of the umask where None. durable: `commit` waits for the disk.
    Errors: OSError, for what exists and is no regular file too.
    """

    def __init__(self, path: Path, *, mode: int | None = None, durable: bool = False) -> None:
        self._path, self._mode, self._durable = path, mode, durable
        remove_abandoned(path.parent, once=True)
        self._replaces = _identity(path)
        self._temporary, descriptor = _create(path)
        self._lock = os.dup(descriptor)  # keeps the lock while the file is closed and named
        self.file: BinaryIO = os.fdopen(descriptor, "wb")
        with _sets:
            _unfinished.add(self)

    def commit(self) -> None:
        """Give the file its name. Errors: OSError, after which nothing is left of it."""
        try:
            self.file.flush()
            with suppress(PermissionError):  # file systems without permissions
                os.fchmod(self._lock, 0o666 & ~_umask() if self._mode is None else self._mode)
            if self._durable:
                os.fsync(self._lock)
            self.file.close()  # network file systems report a full disk here
            self._take_name()
        except BaseException:
            self.discard()
            raise
        self._forget()

    def discard(self) -> None:
        """Remove what was written."""
        with suppress(OSError):  # the disk is full: what cannot be flushed is being thrown away
            self.file.close()
        self.unlink()
        self._forget()

    def unlink(self) -> None:
        """Remove the temporary file and nothing else: for a process that is about to end."""
        with suppress(OSError):
            self._temporary.unlink()

    def _take_name(self) -> None:
        folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            _lock_within(folder, _LONGEST_WAIT_S)  # between the look and the renaming nobody else renames
            found = _identity(self._path)
            if found is not None and found != self._replaces:
                raise OSError(errno.EEXIST, "was written by another process meanwhile", str(self._path))
            self._temporary.replace(self._path)
            if self._durable:
                os.fsync(folder)
        finally:
            os.close(folder)

    def _forget(self) -> None:
        with _sets:
            if self in _unfinished:
                _unfinished.remove(self)
                os.close(self._lock)


def unlink_unfinished() -> None:
    """Remove the temporaries of this process, which is about to end in the middle of its work."""
    for file in list(_unfinished):
        file.unlink()


def is_temporary(name: str) -> bool:
    """Return whether a file is one that grows here, by its name without a folder."""
    return _TEMPORARY.fullmatch(name) is not None


def remove_abandoned(folder: Path, *, once: bool = False) -> None:
    """Remove temporaries whose writer is gone. once: do nothing if this process did so before."""
    try:
        if once:
            found = folder.stat()
            with _sets:
                if (found.st_dev, found.st_ino) in _cleaned:
                    return
                _cleaned.add((found.st_dev, found.st_ino))
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if is_temporary(entry.name)]
    except OSError:  # the write itself is going to fail with the reason
        return
    for name in names:
        with suppress(OSError):  # locked: its writer lives; or not ours
            _remove_unless_locked(folder / name)


def _remove_unless_locked(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
    finally:
        os.close(descriptor)


def _create(path: Path) -> tuple[Path, int]:
    """Create and lock a temporary beside a file; return it and its descriptor."""
    name = os.fsdecode(os.fsencode(path.name)[:_NAME_SHARE])
    for _ in range(_ATTEMPTS):
        temporary = path.with_name(f".{name}.canest-{os.urandom(8).hex()}.part")
        descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            ours = os.fstat(descriptor).st_nlink > 0
        except BlockingIOError:  # another process takes it for abandoned: it was not locked yet
            ours = False
        except OSError:  # some file systems have no locks: nothing is ever removed there either
            ours = True
        if ours:
            return temporary, descriptor
        os.close(descriptor)
    raise OSError(errno.EBUSY, "temporary files are removed as soon as they are made", str(path))


def _lock_within(descriptor: int, timeout_s: float) -> None:
    """Lock a directory; go on without where somebody holds it, or where the file system has no locks."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(0.002)
        except OSError:
            return
        else:
            return


def _identity(path: Path) -> Identity | None:
    """Return what distinguishes one file of a name from the next. Errors: OSError where it is not regular."""
    require_regular(path)
    try:
        found = path.lstat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns, found.st_size


def require_regular(path: Path) -> None:
    """Refuse what exists and is no regular file, or a link to one. Errors: OSError."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISREG(mode):
        raise not_regular(mode, path)


def not_regular(mode: int, path: Path) -> OSError:
    """Return the error that names what was found in a file's place."""
    kinds = {
        stat.S_IFDIR: "directory", stat.S_IFIFO: "FIFO", stat.S_IFSOCK: "socket",
        stat.S_IFCHR: "device", stat.S_IFBLK: "device",
    }  # fmt: skip
    kind = kinds.get(stat.S_IFMT(mode), "special file")
    number = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
    return OSError(number, f"is a {kind}, expected a regular file", str(path))


def _umask() -> int:
    """Return the umask; it can be read without being changed on Linux only."""
    try:
        with Path("/proc/self/status").open(encoding="ascii", errors="replace") as file:
            return next(int(line.split()[1], 8) for line in file if line.startswith("Umask:"))
    except (OSError, StopIteration):
        old = os.umask(0o077)
        os.umask(old)
        return old
