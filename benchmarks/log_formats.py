"""One drive as candump.gz, MF4, BLF and ASC: CPU of `canest replay` on each, whole process, in one run.

Usage: python benchmarks/log_formats.py [--log DRIVE.log.xz] [--config class8] [--repeats 5] [--write]

The formats take turns, and the least of each counts. The frames must be equal to the bit.
--write puts the table into docs/measured/log-formats.md.
"""

from __future__ import annotations

import argparse
import gzip
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import can
import numpy as np

from canest.core.frames import EXTENDED, ID_MASK, FrameBlock
from canest.logs import open_log
from canest.logs.candump_writer import CandumpWriter
from canest.logs.python_can import find_asammdf

PAGE = Path(__file__).parents[1] / "docs" / "measured" / "log-formats.md"
MARK = "<!-- table -->"
LIMITS = {"drive.log.gz": 1.0, "drive.mf4": 1.5, "drive.blf": 1.2, "drive.asc": 2.0}
_RUN = "from canest.cli.main import main; import sys; sys.exit(main())"


def frames_of(path: Path) -> FrameBlock:
    """Return all frames of a log."""
    return FrameBlock.concatenate([block for block in open_log(path) if isinstance(block, FrameBlock)])


def write_all(frames: FrameBlock, folder: Path) -> list[Path]:
    """Write the frames in every format."""
    plain = folder / "drive.log"
    with CandumpWriter(plain) as writer:
        writer.write(frames)
    paths = [folder / name for name in LIMITS]
    paths[0].write_bytes(gzip.compress(plain.read_bytes(), 6))
    find_asammdf()
    columns = (frames.t_us, frames.can_id, frames.length, frames.data)
    for path in paths[1:]:
        with can.Logger(str(path)) as logger:
            for t_us, can_id, length, data in zip(*(c.tolist() for c in columns), strict=True):
                message = can.Message(
                    timestamp=t_us / 1e6,
                    arbitration_id=can_id & ID_MASK,
                    is_extended_id=bool(can_id & EXTENDED),
                    data=data.to_bytes(8, "little")[:length],
                    channel=0,
                )
                logger.on_message_received(message)
    return paths


def cpu_s(log: Path, config: str) -> float:
    """Run `canest replay` in a process of its own; return its user and system time."""
    argv = [sys.executable, "-c", _RUN, "replay", str(log), "-c", config]
    process = subprocess.Popen(argv, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"canest replay {log.name} failed with exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def equal(frames: FrameBlock, expected: FrameBlock) -> bool:
    """Compare to the bit; an .asc log counts its stamps from its first frame."""
    t_us = frames.t_us + (expected.t_us[0] - frames.t_us[0])
    same = [getattr(frames, name) == getattr(expected, name) for name in ("can_id", "length", "data")]
    return len(frames) == len(expected) and bool(np.all([t_us == expected.t_us, *same]))


def main() -> None:
    """Measure, print, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--log", help="a drive (default: one is simulated)")
    parser.add_argument("--config", default="class8")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--write", action="store_true", help="put the table into the page")
    options = parser.parse_args()
    if options.log:
        frames = frames_of(Path(options.log))
    else:
        from canest.simulation import simulate

        frames = simulate("mixed-36t").frames
    with tempfile.TemporaryDirectory() as folder:
        paths = write_all(frames, Path(folder))
        costs = [min(run) for run in zip(*([cpu_s(path, options.config) for path in paths]
                                           for _ in range(options.repeats)), strict=True)]  # fmt: skip
        lines = [
            "| format | MB | CPU s | times candump.gz | at most | frames equal |",
            "|---|---|---|---|---|---|",
        ]
        for path, cost in zip(paths, costs, strict=True):
            same = "yes" if equal(frames_of(path), frames) else "NO"
            size = path.stat().st_size / 1e6
            name = path.name.removeprefix("drive.").replace("log.gz", "candump.gz")
            times = f"{cost / costs[0]:.2f} | {LIMITS[path.name]:g}"
            lines.append(f"| {name} | {size:.1f} | {cost:.2f} | {times} | {same} |")
    table = "\n".join([f"{len(frames):,} frames:", "", *lines])
    print(table)
    if options.write:
        before = PAGE.read_text().partition(MARK)[0]
        PAGE.write_text(f"{before}{MARK}\n\n{table}\n")


if __name__ == "__main__":
    main()
