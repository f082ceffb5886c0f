"""Replay speed and memory on a bus of 1,000 frames/s, beside what most people write.

Usage: python benchmarks/replay_speed.py [--log DRIVE.log.xz] [--config class8] [--hours 1 10] [--keep DIR]

One drive is repeated with shifted stamps. The cost per frame is the slope between a short and a long log, so
start-up counts in the whole-process figure only (numba is used from 45 minutes of log on).
Peers run on a part of the same log, in this process, in turn with the replays: a shared machine is not as
fast all the time. Of the rounds there is the median, the least and the most. Costs and ratios are CPU time:
on an idle machine that is the time on the clock and on a busy one still means something.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from canest.core.frames import FrameBlock
from canest.logs import open_log
from canest.logs.candump_writer import CandumpWriter

PEER_FRAMES = 100_000
SHORT_LOG_S = 600.0
ROUNDS = 3
#: J1939: data page, format and specific, without priority and source; cantools wants it applied by the caller
_PGN_MASK = 0x03FF_FF00
_RUN = "from canest.cli.main import main; import sys; sys.exit(main())"
_WITHOUT_NUMBA = "import sys; sys.modules['numba'] = None; "


@dataclass
class Cost:
    """What one process took."""

    wall_s: float
    cpu_s: float
    peak_mb: float


def drive(path: str | None) -> FrameBlock:
    """Return the frames of one drive, simulated when none is given."""
    if path is not None:
        return FrameBlock.concatenate([b for b in open_log(path) if isinstance(b, FrameBlock)])
    from canest.simulation import simulate

    return simulate("mixed-36t").frames


def repeat(one: FrameBlock, duration_s: float, path: Path) -> int:
    """Write ``one`` again and again until ``duration_s`` is full; return the number of frames."""
    period_us = int(one.t_us[-1] - one.t_us[0]) + 1000
    frames = 0
    with CandumpWriter(path) as writer:
        for start_us in range(0, round(duration_s * 1e6), period_us):
            end_us = int(one.t_us[0]) + round(duration_s * 1e6) - start_us
            part = one if one.t_us[-1] <= end_us else one[one.t_us <= end_us]
            writer.write(FrameBlock(part.t_us + start_us, part.can_id, part.length, part.data))
            frames += len(part)
    return frames


def replay(log: Path, config: str, numba: bool) -> Cost:
    """Run `canest replay` in a process of its own."""
    code = _RUN if numba else _WITHOUT_NUMBA + _RUN
    output = log.with_suffix(".est.csv")
    argv = ["replay", str(log), "-c", config, "-o", str(output), "--json", str(log.with_suffix(".json"))]
    begin = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code, *argv], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - begin
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"canest replay failed with exit code {process.returncode}")
    output.unlink()
    return Cost(wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def python_can_and_cantools(log: Path, dbc: Path) -> float:
    """Return seconds of the loop that most people write."""
    import can
    import cantools

    database = cantools.database.load_file(dbc, frame_id_mask=_PGN_MASK, strict=False)
    begin = time.process_time()
    decoded = 0
    for message in can.CanutilsLogReader(str(log)):
        try:
            database.decode_message(message.arbitration_id & _PGN_MASK, message.data, decode_choices=False)
            decoded += 1
        except (KeyError, cantools.database.DecodeError):
            pass
    took = time.process_time() - begin
    assert decoded, "the DBC knows none of these frames"
    return took


def asammdf_extraction(log: Path, dbc: Path) -> float:
    """Return seconds of asammdf's vectorised extraction of all signals, its own log format already open."""
    import can
    from asammdf import MDF

    path = log.with_suffix(".mf4")
    with can.MF4Writer(str(path)) as writer:
        for message in can.CanutilsLogReader(str(log)):
            message.channel = 1
            writer.on_message_received(message)
    with MDF(path) as mdf:
        begin = time.process_time()
        extracted = mdf.extract_bus_logging({"CAN": [(str(dbc), 0)]})
        took = time.process_time() - begin
        assert extracted.groups, "asammdf extracted nothing"
        extracted.close()
    return took


#: what others take, by name
PEERS = {
    "python-can + cantools, decoding only": python_can_and_cantools,
    "asammdf, extraction only": asammdf_extraction,
}


def peer(name: str, run: Callable[[Path, Path], float], log: Path, dbc: Path) -> float:
    """Return the seconds that a peer takes, NaN where it cannot run here."""
    try:
        return run(log, dbc)
    except Exception as error:  # a peer that is missing or fails must not end the benchmark
        print(f"{name} not measured ({type(error).__name__}: {error})")
        return math.nan


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--log", help="a drive to repeat (default: one is simulated)")
    parser.add_argument("--config", default="class8")
    parser.add_argument("--hours", type=float, nargs=2, default=(1.0, 10.0), metavar=("SHORT", "LONG"))
    parser.add_argument("--keep", type=Path, help="directory for the logs (default: a temporary one)")
    options = parser.parse_args()
    one = drive(options.log)
    rate = len(one) / ((one.t_us[-1] - one.t_us[0]) / 1e6)
    python = sys.version.split()[0]
    print(f"{os.cpu_count()} cores, Python {python}, numpy {np.__version__}; {rate:.0f} frames/s on the bus")
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        measure(one, folder, options.config, options.hours)


def measure(one: FrameBlock, folder: Path, config: str, hours: tuple[float, float]) -> None:
    """Write the logs into ``folder``, run everything on them round by round, print figures and ratios."""
    from canest.system.shipped_files import shipped

    durations_s = (SHORT_LOG_S, *(3600 * h for h in hours))
    logs = [folder / f"{duration_s:.0f}s.log" for duration_s in durations_s]
    frames = [repeat(one, duration_s, log) for duration_s, log in zip(durations_s, logs, strict=True)]
    part, dbc = folder / "peers.log", shipped("dbc") / "j1939.dbc"
    with CandumpWriter(part) as writer:
        writer.write(one[:PEER_FRAMES])
    to_ns = 1e9 / min(PEER_FRAMES, len(one))
    peers_ns: dict[str, list[float]] = {name: [] for name in PEERS}
    costs: dict[bool, list[list[Cost]]] = {True: [], False: []}
    for number in range(1, ROUNDS + 1):
        print(f"round {number} of {ROUNDS}", file=sys.stderr, flush=True)
        for name, run in PEERS.items():
            peers_ns[name].append(to_ns * peer(name, run, part, dbc))
        for numba, taken in costs.items():
            taken.append([replay(log, config, numba) for log in logs])
    peers_ns = {name: found for name, found in peers_ns.items() if not np.isnan(found).any()}
    for name, found in peers_ns.items():
        print(f"{name:<44} {spread(found, 0)} ns/frame")
    for numba, taken in costs.items():
        name = "canest replay, " + ("numba" if numba else "plain numpy")
        more = (frames[2] - frames[1]) / 1e9
        slopes = [(long.cpu_s - short.cpu_s) / more for _, short, long in taken]
        walls = [(long.wall_s - short.wall_s) / more for _, short, long in taken]
        print(
            f"{name + ', text to estimates on disk':<44} {spread(slopes, 0)} ns/frame "
            f"({spread(walls, 0)} on the clock)"
        )
        for other, found in peers_ns.items():
            print(f"    {other} over canest: {spread(list(np.divide(found, slopes)), 1)}")
        titles = ("10 min", f"{hours[0]:g} h", f"{hours[1]:g} h")
        for title, runs in zip(titles, zip(*taken, strict=True), strict=True):
            best, peak_mb = min(runs, key=lambda cost: cost.cpu_s), max(cost.peak_mb for cost in runs)
            print(f"    {title:<8} {best.wall_s:7.2f} s whole process ({best.cpu_s:.2f} of CPU), ", end="")
            print(f"{peak_mb:6.0f} MB at most")


def spread(values: list[float], digits: int) -> str:
    """Return the median, and the least and the most."""
    return f"{np.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


if __name__ == "__main__":
    main()
