"""Folders for temporary files of processes; what killed ones left is removed by the next."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PREFIX = "canest-fleet-"
#: a folder is locked as soon as it is made; one that is older and has no lock has no owner
_UNLOCKED_S = 60.0


@contextmanager
def work_folder() -> Iterator[Path]:
    """Give a folder that goes with the `with`. Errors: OSError."""
    remove_abandoned()
    with tempfile.TemporaryDirectory(prefix=PREFIX) as name:
        lock = os.open(name, os.O_RDONLY | os.O_DIRECTORY)
        try:
            with suppress(OSError):  # file systems without locks
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield Path(name)
        finally:
            os.close(lock)


def remove_abandoned() -> None:
    """Remove folders whose process is gone."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with suppress(OSError):  # locked: its process lives; or not ours
            _remove_unless_locked(folder)


def _remove_unless_locked(folder: Path) -> None:
    found = folder.stat()
    if found.st_uid != os.getuid() or time.time() - found.st_mtime < _UNLOCKED_S:
        return
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)
    finally:
        os.close(lock)
