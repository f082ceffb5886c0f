"""Random mutation of seeds, and what no input may do: raise, take a second, eat memory."""

from __future__ import annotations

import contextlib
import random
import resource
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import canest

from .targets import Target

MOST_CPU_S = 4.0  #: of one input; CPU time, since a busy machine is not the program's fault
MOST_WALL_S = 20.0
MOST_GROWTH_MB = 300.0
LARGEST = 40_000
TRACE_EVERY = 4  #: tracing costs a factor of ten: only every so many inputs look for new lines
_CANEST = str(Path(canest.__file__).parent)


class Coverage:
    """Lines of canest reached so far; a context that adds to them."""

    def __init__(self) -> None:
        self.lines: set[tuple[str, int]] = set()

    def __enter__(self) -> Coverage:
        sys.settrace(self._call)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _call(self, frame: FrameType, event: str, argument: Any) -> Any:
        return self._line if frame.f_code.co_filename.startswith(_CANEST) else None

    def _line(self, frame: FrameType, event: str, argument: Any) -> Any:
        self.lines.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line


class Finding(Exception):
    """An input did harm; ``data`` is the input."""

    def __init__(self, target: str, data: bytes, why: str) -> None:
        super().__init__(f"{target}: {why} (input of {len(data)} bytes)")
        self.data = data


class _TooSlow(BaseException):
    """Not an Exception: nothing that reads a log may swallow it."""


@contextlib.contextmanager
def _deadline(most_cpu_s: float) -> Iterator[None]:
    def late(number: int, frame: object) -> None:
        raise _TooSlow

    before = signal.signal(signal.SIGPROF, late), signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_PROF, most_cpu_s)
    signal.setitimer(signal.ITIMER_REAL, MOST_WALL_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGPROF, before[0])
        signal.signal(signal.SIGALRM, before[1])


def run_one(target: Target, data: bytes, most_cpu_s: float = MOST_CPU_S) -> None:
    """Run one input. Errors: Finding."""
    begin_s = time.process_time()
    try:
        with _deadline(most_cpu_s):
            target.run(data)
    except _TooSlow:
        raise Finding(target.name, data, f"took more than {most_cpu_s:g} s") from None
    except Exception as error:
        raise Finding(target.name, data, f"{type(error).__name__}: {str(error)[:200]}") from error
    if time.process_time() - begin_s > most_cpu_s:
        raise Finding(target.name, data, f"took {time.process_time() - begin_s:.1f} s")


def mutated(rng: random.Random, target: Target, pool: list[bytes]) -> bytes:
    """Return a seed with a few random changes."""
    data = bytearray(rng.choice(pool))
    for _ in range(1 + rng.getrandbits(2) * rng.getrandbits(2)):
        n = len(data)
        at, span = rng.randrange(n + 1), min(n, 1 << rng.randrange(10))
        choice = rng.randrange(8)
        if choice == 0 and n:
            data[at % n] = rng.getrandbits(8)
        elif choice == 1 and n:
            data[at % n] ^= 1 << rng.randrange(8)
        elif choice == 2:
            del data[at : at + span]
        elif choice == 3:
            data[at:at] = data[at : at + span] * rng.choice((1, 1, 2, 20))
        elif choice == 4:
            data[at : at + rng.randrange(4)] = (
                rng.choice(target.tokens) if target.tokens else rng.randbytes(2)
            )
        elif choice == 5:
            other = rng.choice(pool)
            begin = rng.randrange(len(other) + 1)
            data[at:at] = other[begin : begin + span]
        elif choice == 6:
            data[at : at + 4] = rng.choice(
                (b"\0\0\0\0", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\1\0\0\0")
            )
        else:
            data[at : at + span] = rng.randbytes(span)
    return bytes(data[:LARGEST])


def fuzz(target: Target, seconds: float, seed: int = 0) -> str:
    """Run mutated inputs for some seconds, guided by the lines they reach; return a line of figures.

    Errors: Finding, at the first.
    """
    rng, coverage = random.Random(seed), Coverage()
    pool = list(target.seeds())
    with contextlib.suppress(Exception):
        target.run(pool[0])  # what is made once (imports, a drive) is not the input's fault
    for data in pool:
        run_one(target, data)
        with coverage, contextlib.suppress(Exception):
            target.run(data)
    by_seeds, peak_kb = len(coverage.lines), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin_s, count, slowest_s = time.monotonic(), 0, 0.0
    while time.monotonic() - begin_s < seconds:
        data = mutated(rng, target, pool)
        input_s = time.process_time()
        run_one(target, data)
        slowest_s = max(slowest_s, time.process_time() - input_s)
        count += 1
        if count % TRACE_EVERY == 0:
            before = len(coverage.lines)
            with coverage, contextlib.suppress(Exception):
                target.run(data)
            if len(coverage.lines) > before:
                pool.append(data)
    growth_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kb) / 1024
    if growth_mb > MOST_GROWTH_MB:
        raise Finding(target.name, b"", f"memory grew by {growth_mb:.0f} MB in {count} inputs")
    return (
        f"{target.name}: {count:,} inputs in {seconds:.0f} s, {len(coverage.lines)} lines ({by_seeds} "
        f"by the seeds), slowest {1e3 * slowest_s:.0f} ms, memory +{growth_mb:.0f} MB, nothing found"
    )
