"""Files that are whole or not there at all, and a thread that waits for the disk in the loop's stead."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from pathlib import Path

from canest.system.atomic_file import AtomicFile

_QUEUED = 256  #: jobs waiting for a slow disk; more are refused and counted


def write_atomically(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Replace a file: whoever reads it, or loses power meanwhile, has the old or the new content.

    durable: also wait until it is on the disk (file and directory).
    Errors: OSError, also where the name belongs to a directory, FIFO, socket or device.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with file_name_in_errors(path):
        file = AtomicFile(path, mode=0o644, durable=durable)
        try:
            file.file.write(content)
        except BaseException:
            file.discard()
            raise
        file.commit()


@contextlib.contextmanager
def file_name_in_errors(path: Path) -> Iterator[None]:
    """Add the file's name to errors of the system about a file that is open already."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


class Background:
    """One thread that does the writing, in order.

    A disk that hangs or is full costs what was to be written, never a tick. `counters` has, per kind of
    job, what was done, failed (with the error) and refused; `failures` the last error's text.
    """

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()
        self.failures: dict[str, str] = {}
        self._jobs: deque[tuple[str, Callable[[], None]]] = deque()
        self._wake = threading.Condition()
        self._busy = self._closing = False
        self._thread = threading.Thread(target=self._work, name="canest-files", daemon=True)
        self._thread.start()

    def submit(self, kind: str, job: Callable[[], None], *, newest_only: bool = False) -> bool:
        """Queue a job; with ``newest_only`` it replaces a waiting one of its kind. False: refused."""
        with self._wake:
            if newest_only:
                self._jobs = deque((k, j) for k, j in self._jobs if k != kind)
            elif len(self._jobs) >= _QUEUED:
                self.counters[f"{kind}_refused"] += 1
                return False
            self._jobs.append((kind, job))
            self._wake.notify()
        return True

    def close(self, timeout_s: float) -> bool:
        """Finish what is queued; False when that took longer than ``timeout_s``."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def flush(self, timeout_s: float) -> bool:
        """Wait until nothing is queued or running; False when that took longer."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            with self._wake:
                if not self._jobs and not self._busy:
                    return True
            time.sleep(0.002)
        return False

    def _work(self) -> None:
        while True:
            with self._wake:
                self._busy = False
                while not self._jobs:
                    if self._closing:
                        return
                    self._wake.wait()
                kind, job = self._jobs.popleft()
                self._busy = True
            try:
                job()
            except Exception as error:  # a thread that dies silently is the worst of all
                self.counters[f"{kind}_failed"] += 1
                self.failures[kind] = str(error)
            else:
                self.counters[f"{kind}_done"] += 1
                self.failures.pop(kind, None)
