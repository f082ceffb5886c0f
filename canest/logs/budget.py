"""What reading one log may cost: computing time, unpacked size and memory.

A log of a few hundred bytes may describe an endless one, so the cost is bounded while it arises. Only the
steps of reading count: whoever takes the blocks (an estimator, a bus in the log's rhythm, a pipe) has all
the time.
"""

from __future__ import annotations

import contextlib
import math
import os
import resource
import signal
import threading
import time
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple

from canest.core.errors import LogError

TIME_S = 60.0  #: for any log
TIME_S_PER_BYTE = 60.0 / 100e6
#: below this an archive may unpack to any multiple of its size
UNPACKED_BYTES_MIN = 1 << 28
OPTION = "--log-budget"
_TICK_S = 0.25
#: pyarrow's allocator reserves 1 GB of addresses before the first byte
_RESERVED_BYTES = 3 << 29
#: beyond the budget, for code that never comes back to Python; the kernel then ends the process
_CPU_GRACE_S = 60
_STATM_RESIDENT, _STATM_DATA = 1, 5


class LogBudget(NamedTuple):
    """Limits of one log; infinite for none.

    time_s: of computing; None for 60 s and 60 s more per 100 MB of log, unpacked.
    unpacked: an archive may become so many times its size (and 256 MB in any case). memory_mb: in MB.
    """

    time_s: float | None = None
    unpacked: float = 200.0
    memory_mb: float = 2000.0

    def allowed_s(self, size: float) -> float:
        """Return the computing time of a log of ``size`` bytes."""
        return TIME_S + TIME_S_PER_BYTE * size if self.time_s is None else self.time_s


NO_BUDGET = LogBudget(math.inf, math.inf, math.inf)
_DEFAULT = LogBudget()
_current: ContextVar[LogBudget] = ContextVar("log_budget", default=_DEFAULT)


def current_budget() -> LogBudget:
    """Return what a log opened now may cost."""
    return _current.get()


@contextlib.contextmanager
def log_budget(budget: LogBudget) -> Iterator[None]:
    """Let every log opened inside cost so much."""
    token = _current.set(budget)
    try:
        yield
    finally:
        _current.reset(token)


class _OverBudgetError(BaseException):
    """Raised inside whatever reads; not an Exception, since libraries swallow those."""


class Meter:
    """Measures what reading one log costs; a context manager around each of its steps.

    In the main thread a timer looks at the cost four times per second of computing, also while a library
    loops; in any other thread it is looked at between the steps. The kernel refuses memory far beyond it.

    stored: bytes that the log takes up where it lies; of a pipe, that came so far. unpacked: bytes that came
    out of an archive so far.
    Errors: LogError from the step that exceeds the budget of `current_budget`.
    """

    def __init__(self, path: Path, stored: int) -> None:
        self._path, self._budget = path, current_budget()
        self.stored = stored
        self.unpacked = 0
        self.exceeded: LogError | None = None
        self._spent_s = self._begin_s = 0.0
        self._grown_bytes = self._resident_bytes = 0
        self._watching = False

    def unpack(self, size: int) -> None:
        """Count bytes that came out of an archive. Errors: LogError."""
        self.unpacked += size
        limit = self._budget.unpacked
        if self.unpacked > max(UNPACKED_BYTES_MIN, limit * self.stored):
            self._exceed(
                f"unpacks to more than {limit:g} times its size", f"{self.unpacked / 1e6:,.0f} MB so far",
                "unpacked=TIMES",
            )  # fmt: skip
        self.raise_if_exceeded()

    def raise_if_exceeded(self) -> None:
        """Raise what a library may have swallowed. Errors: LogError."""
        if self.exceeded is not None:
            raise self.exceeded from None

    @property
    def memory_bytes(self) -> float:
        """What a log may take of memory."""
        return self._budget.memory_mb * 1e6

    def refuse_memory(self, needed_bytes: float) -> None:
        """Refuse, before it is read, what needs too much memory. Errors: LogError."""
        if needed_bytes > self.memory_bytes:
            self._exceed_memory(f"{needed_bytes / 1e6:,.0f} MB")
            self.raise_if_exceeded()

    def __enter__(self) -> Meter:
        self._begin_s, self._resident_bytes = time.process_time(), _memory(_STATM_RESIDENT)
        self._in_main = threading.current_thread() is threading.main_thread()
        if self._in_main:
            self._handler = signal.signal(signal.SIGVTALRM, self._tick)
            signal.siginterrupt(signal.SIGVTALRM, False)
            self._timer = signal.setitimer(signal.ITIMER_VIRTUAL, _TICK_S, _TICK_S)
            self._limits = {
                kind: resource.getrlimit(kind) for kind in (resource.RLIMIT_DATA, resource.RLIMIT_CPU)
            }
            most = self._budget.memory_mb * 1e6 - max(self._grown_bytes, 0) + _RESERVED_BYTES
            self._lower(resource.RLIMIT_DATA, _memory(_STATM_DATA) + most)
            self._lower_cpu()
        self._watching = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._watching = False
        if self._in_main:
            signal.setitimer(signal.ITIMER_VIRTUAL, *self._timer)
            signal.signal(signal.SIGVTALRM, self._handler)
            for limited, limits in self._limits.items():
                resource.setrlimit(limited, limits)
        if isinstance(error, MemoryError):
            self._exceed_memory()
        elif error is None or isinstance(error, Exception):  # of an interrupt nothing more is asked
            self._look()
        self._spent_s += time.process_time() - self._begin_s
        self._grown_bytes += _memory(_STATM_RESIDENT) - self._resident_bytes
        self.raise_if_exceeded()

    def _tick(self, number: int, frame: object) -> None:
        if not self._watching:
            return
        self._look()
        if self.exceeded is not None:
            raise _OverBudgetError
        self._lower_cpu()

    def _look(self) -> None:
        """Note what has been exceeded by now."""
        allowed_s = self._budget.allowed_s(max(self.stored, self.unpacked))
        if self._spent_s + time.process_time() - self._begin_s > allowed_s:
            self._exceed(f"takes more than {allowed_s:,.0f} s of computing to read", None, "time=SECONDS")
        grown = self._grown_bytes + _memory(_STATM_RESIDENT) - self._resident_bytes
        if grown > self.memory_bytes:
            self._exceed_memory()

    def _exceed_memory(self, found: str | None = None) -> None:
        self._exceed(
            f"takes more than {self._budget.memory_mb:,.0f} MB of memory to read", found, "memory=MB"
        )

    def _exceed(self, what: str, found: object, setting: str) -> None:
        if self.exceeded is None:
            expected = f"a log of its size ({OPTION} {setting} allows more)"
            self.exceeded = LogError(what, where=str(self._path), found=Amount(found) if found else None,
                                     expected=expected)  # fmt: skip

    def _lower_cpu(self) -> None:
        left_s = self._budget.allowed_s(max(self.stored, self.unpacked)) - self._spent_s
        self._lower(resource.RLIMIT_CPU, self._begin_s + max(left_s, 0.0) + _CPU_GRACE_S)

    def _lower(self, kind: int, most: float) -> None:
        soft, hard = self._limits[kind]
        lowest = min(value for value in (most, *(math.inf if v == resource.RLIM_INFINITY else v
                                                 for v in (soft, hard))))  # fmt: skip
        if lowest < math.inf:
            resource.setrlimit(kind, (int(lowest), hard))


class Amount(str):
    """Text that a message shows without quotes."""

    __repr__ = str.__str__


def stored_bytes(file: BinaryIO) -> int:
    """Return how many bytes a file takes up where it lies: of one with holes, less than its length."""
    status = os.fstat(file.fileno())
    if status.st_blocks:
        return min(status.st_size, status.st_blocks * 512)
    try:  # some file systems report no blocks
        os.lseek(file.fileno(), 0, os.SEEK_DATA)
    except OSError:  # nothing but a hole, or no regular file
        return 0
    os.lseek(file.fileno(), 0, os.SEEK_SET)
    return status.st_size


def _memory(field: int) -> int:
    """Return a field of this process' /proc/self/statm in bytes, 0 where there is none."""
    try:
        with open("/proc/self/statm", "rb", buffering=0) as file:  # noqa: PTH123 - twice per block
            return int(file.read().split()[field]) * resource.getpagesize()
    except OSError:
        return 0
