"""Coverage-guided fuzzing of all that reads what others wrote: no exception may escape, nothing may hang.

    python benchmarks/fuzz.py [--minutes 10] [--target state,config,log,frames,broadcast] [--seed N]

A mutation that reaches a line of canest not reached before joins the corpus (line coverage by sys.settrace).
A run of more than a second of CPU time is a hang. What fails is written to fuzz-TARGET-N.bin here, and
the exit code is 1.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
HANG_S = 1.0
TRACE_EVERY = 4  #: tracing costs a factor of ten: only every so many runs look for new lines
MARK = str(ROOT / "canest")


class Hang(BaseException):
    """A run took more CPU time than `HANG_S`."""


@contextmanager
def deadline() -> Iterator[None]:
    def over(number: int, frame: FrameType | None) -> None:
        raise Hang

    signal.signal(signal.SIGPROF, over)
    signal.setitimer(signal.ITIMER_PROF, HANG_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


class Coverage:
    """Lines of canest reached so far."""

    def __init__(self) -> None:
        self.lines: set[tuple[str, int]] = set()

    def run(self, job: Callable[[], None]) -> bool:
        """Run traced; True when new lines were reached."""
        before = len(self.lines)
        sys.settrace(self._call)
        try:
            job()
        finally:
            sys.settrace(None)
        return len(self.lines) > before

    def _call(self, frame: FrameType, event: str, argument: Any) -> Any:
        return self._line if frame.f_code.co_filename.startswith(MARK) else None

    def _line(self, frame: FrameType, event: str, argument: Any) -> Any:
        self.lines.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line


#: pieces that mean something to some parser
TOKENS = [
    *(b"", b"0", b"-1", b"1e999", b"nan", b"NaN", b"null", b"true", b"[]", b"{}", b'"', b"\n", b"\r\n", b":"),
    *(b"- ", b"#", b"##1", b"R8", b"  [8]  ", b"(1700000000.000000)", b" can0 ", b"18FEF100", b"9" * 400),
    *(b"\x00", b"\xff\xfe", b"&a [*a]", b"!!python/object:os.system x", b"? ", b"<<: ", b"%", b"1970-13-45"),
    *(b"0x", b"~", b"{a: {a: {a: "),
]


def mutate(data: bytes, corpus: list[bytes], rng: random.Random) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 4, 8))):
        at = rng.randrange(len(data) + 1)
        end = min(len(data), at + rng.choice((1, 1, 2, 4, 16, 64)))
        kind = rng.randrange(7)
        if kind == 0 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + data[end:]
        elif kind == 2:
            data = data[:at] + rng.choice(TOKENS) + data[at:]
        elif kind == 3:
            data = data[:at] + rng.choice(TOKENS) + data[end:]
        elif kind == 4:
            data = data[:end] + data[at:]
        elif kind == 5:
            data = data[:at] + rng.randbytes(end - at) + data[end:]
        else:
            other = rng.choice(corpus)
            cut = rng.randrange(len(other) + 1)
            data = data[:at] + other[cut : cut + 64] + data[end:]
    return data[:200_000]


class Target:
    """One thing to be fuzzed: seeds, and a run that returns normally or raises what it should not."""

    seeds: list[bytes]

    def run(self, data: bytes) -> None:
        raise NotImplementedError


class State(Target):
    def __init__(self, folder: Path) -> None:
        from canest.config import load_config
        from canest.live import state

        self.state, self.config, self.path = state, load_config("vcan"), folder / "state.json"
        key, mark = state.vehicle_key(self.config), state.fingerprint(self.config)
        state.save(self.path, state.Learned(key, mark, 20_000.0, 100.0, 1.7e9, True, 12.5))
        self.seeds = [self.path.read_bytes()]

    def run(self, data: bytes) -> None:
        self.path.write_bytes(data)
        learned = self.state.load(self.path, self.config, 1.8e9).learned
        if learned is not None:
            std_kg = self.state.widened_std_kg(learned, self.config, 1.8e9)
            assert 7_000 <= learned.mass_kg <= 40_000 and 0 < std_kg < 1e12, learned


class Config(Target):
    def __init__(self, folder: Path) -> None:
        self.seeds = [p.read_bytes() for p in sorted((ROOT / "configs").glob("*.yaml"))]
        self.folder = folder

    def run(self, data: bytes) -> None:
        from canest.config import load_config
        from canest.errors import CanestError

        path = self.folder / "config.yaml"
        path.write_bytes(data)
        try:
            load_config(path)
        except CanestError as error:
            assert "\n" not in str(error), "an error of several lines"


class Log(Target):
    def __init__(self, folder: Path) -> None:
        import lzma

        with lzma.open(ROOT / "tests/data/kenworth/normal.log.xz") as file:
            text = file.read(4000)
        screen = b" (000.005001)  can0  18FEDF00   [8]  8A A0 28 7D 7D FF FF F0\n" * 3
        self.seeds = [text, screen, text[:900].replace(b"can1", b"vcan0"), b"t_s,v\n0,1\n0.1,2\n"]
        self.path = folder / "drive.log"

    def run(self, data: bytes) -> None:
        from canest.errors import CanestError
        from canest.logs.reader import open_log

        self.path.write_bytes(data)
        try:
            for _ in open_log(self.path):
                pass
        except CanestError as error:
            assert "\n" not in str(error), "an error of several lines"


_ROW = struct.Struct("<iIB8s")


class Frames(Target):
    """Arbitrary frames through decoder, BAM reassembly, grid, model and estimator."""

    def __init__(self, folder: Path) -> None:
        from canest.config import load_config
        from canest.pipeline import Pipeline

        self.config, self.make = load_config("vcan", ["estimator.name=rlsmf"]), Pipeline
        self.pipeline, self.runs = Pipeline(self.config), 0
        wanted = [0x8CF00400, 0x8CF00203, 0x98FEF100, 0x98FEE300, 0x9CECFF00, 0x9CEBFF00, 0x98F00503]
        rng = random.Random(1)
        bam = bytes([32, 28, 0, 4, 255, 0xE3, 0xFE, 0])
        rows = [(0x9CECFF00, bam)] + [(0x9CEBFF00, bytes([n, *rng.randbytes(7)])) for n in range(1, 5)]
        rows += [(i, rng.randbytes(8)) for i in wanted for _ in range(3)]
        self.seeds = [b"".join(_ROW.pack(1000, i, 8, p) for i, p in rows)]

    def run(self, data: bytes) -> None:
        import numpy as np

        from canest.frames import FrameBlock

        self.runs += 1
        if self.runs % 500 == 0:  # a state that no frame can leave would hide what comes later
            self.pipeline = self.make(self.config)
        rows = [_ROW.unpack_from(data, at) for at in range(0, len(data) - _ROW.size + 1, _ROW.size)][:400]
        t_us, frames = 1_700_000_000_000_000, []
        for step, can_id, length, payload in rows:
            t_us += max(-5_000_000_000, min(step, 200_000))
            frames.append((t_us, can_id, payload[: length % 9]))
        estimates = self.pipeline.push(FrameBlock.from_frames(frames))
        known = estimates.mass_kg[~np.isnan(estimates.mass_kg)]
        assert not len(known) or (known.min() > 0 and np.isfinite(known).all()), "a mass nobody can believe"


class Broadcast(Target):
    """Arbitrary frames to the node: claims, requests, other users of our group."""

    def __init__(self, folder: Path) -> None:
        from canest.config import load_config

        self.config = load_config("vcan", ["broadcast.cvw=true"])
        ids = [0x98EEFF9E, 0x98EAFF21, 0x98EA9E21, 0x98FF5A44, 0x98FE700B]
        self.seeds = [b"".join(_ROW.pack(20_000, i, 8, bytes(range(8))) for i in ids)]

    def run(self, data: bytes) -> None:
        from collections import Counter

        from canest.frames import FrameBlock
        from canest.live.node import Node
        from canest.live.watch import BusWatch

        class Wire:
            def __init__(self) -> None:
                self.counters: Counter[str] = Counter()
                self.sent = 0

            def send(self, can_id: int, payload: bytes) -> bool:
                assert len(payload) == 8 and can_id & 0x8000_0000
                self.sent += 1
                return self.sent % 7 > 0

        node, wire, now_us = Node(self.config, BusWatch(0xFF5A)), Wire(), 1_000_000
        node.attach(self.config, wire, now_us)
        for at in range(0, min(len(data), 4000) - _ROW.size + 1, _ROW.size):
            step, can_id, length, payload = _ROW.unpack_from(data, at)
            now_us += abs(step) % 3_000_000
            node.observe(FrameBlock.from_frames([(now_us, can_id, payload[: length % 9])]), now_us)
            node.speak(now_us)
        # a claim, a refusal and an estimate in all groups per 100 ms is the most there may ever be
        assert wire.sent <= 20 + (now_us - 1_000_000) / 20_000 + 4 * len(data) / _ROW.size


TARGETS: dict[str, type[Any]] = {
    "state": State, "config": Config, "log": Log, "frames": Frames, "broadcast": Broadcast,
}  # fmt: skip


def fuzz(name: str, minutes: float, seed: int) -> int:
    """Fuzz one target; return the number of failures."""
    rng, coverage = random.Random(seed), Coverage()
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        target: Target = TARGETS[name](Path(folder))
        corpus, failures, runs, slowest = list(target.seeds), 0, 0, 0.0
        for data in corpus:
            coverage.run(lambda data=data: target.run(data))  # type: ignore[misc]
        first, end = len(coverage.lines), time.monotonic() + 60 * minutes
        while time.monotonic() < end:
            data = mutate(rng.choice(corpus), corpus, rng)
            runs += 1
            begin = time.process_time()
            try:
                with deadline():
                    if runs % TRACE_EVERY:
                        target.run(data)
                    elif coverage.run(lambda data=data: target.run(data)):  # type: ignore[misc]
                        corpus.append(data)
            except (Exception, Hang):
                failures += 1
                Path(f"fuzz-{name}-{failures}.bin").write_bytes(data)
                traceback.print_exc()
                if failures >= 10:
                    break
            if runs % TRACE_EVERY:
                slowest = max(slowest, time.process_time() - begin)
    print(
        f"{name:10s} {runs:8,} runs, {len(coverage.lines)} lines reached ({first} by the seeds), "
        f"corpus {len(corpus)}, slowest run {1e3 * slowest:.0f} ms, {failures} failures",
        flush=True,
    )
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--target", default=",".join(TARGETS))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    failures = [fuzz(name, arguments.minutes, arguments.seed) for name in arguments.target.split(",")]
    return 1 if any(failures) else 0


if __name__ == "__main__":
    sys.exit(main())
