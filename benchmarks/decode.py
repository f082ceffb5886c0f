"""Cost of decoding: nanoseconds per frame in long blocks, microseconds per live block of 20 ms.

Usage: python benchmarks/decode.py [--log LOG] [--config CONFIG]

The log is repeated to 400,000 frames; `canest.decode.decoder.SHORT_BLOCK` follows from the last lines.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import time
from pathlib import Path

import numpy as np

from canest.config import Config, load_config
from canest.core.frames import FrameBlock
from canest.decode import decoder
from canest.logs import open_log
from canest.pipeline.signal_map import decoder_for

KENWORTH = Path(__file__).resolve().parent.parent / "tests" / "data" / "kenworth" / "normal.log.xz"


def best_ns_per_frame(config: Config, block: FrameBlock, size: int, repeats: int = 7) -> float:
    """Return the best of some runs over the block in pieces of ``size`` frames."""
    best = float("inf")
    pieces = [block[i : i + size] for i in range(0, len(block), size)]
    for _ in range(repeats):
        fresh = decoder_for(config)
        fresh.push(block[:200])  # senders and identifiers known, as after the first second
        start = time.perf_counter()
        for piece in pieces:
            fresh.push(piece)
        best = min(best, time.perf_counter() - start)
    return best / len(block) * 1e9


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--log", default=KENWORTH, help="a log of frames (default: the bundled Kenworth's)")
    parser.add_argument("--config", default="kenworth", help="whose signals are decoded (default: kenworth)")
    options = parser.parse_args()
    config = load_config(options.config)
    one = FrameBlock.concatenate([b for b in open_log(options.log) if isinstance(b, FrameBlock)])
    copies = max(1, 400_000 // len(one))
    long = FrameBlock.concatenate([one] * copies)
    print(f"{len(long)} frames, {len(config.signals)} roles")
    for size in (1_000_000, 100_000, 10_000, 1_000):
        print(f"blocks of {size:>7}: {best_ns_per_frame(config, long, size):6.1f} ns/frame")
    live = one[: min(len(one), 40_000)]
    edges = np.searchsorted(live.t_us, np.arange(live.t_us[0], live.t_us[-1], 20_000))
    pieces = [live[a:b] for a, b in itertools.pairwise(edges)]
    for name, short in (("frame by frame", 10**9), ("in columns", 0)):
        decoder.SHORT_BLOCK = short
        fresh = decoder_for(config)
        costs = []
        for piece in pieces:
            start = time.perf_counter()
            fresh.push(piece)
            costs.append((time.perf_counter() - start) * 1e6)
        print(
            f"live, 20 ms blocks of {len(live) / len(pieces):.1f} frames, {name}: "
            f"median {statistics.median(costs):.1f} us, 99 % {np.quantile(costs, 0.99):.1f} us"
        )
    for size in (32, 64, 96, 128, 256, 512):
        decoder.SHORT_BLOCK = 10**9
        scalar = best_ns_per_frame(config, live, size, 3)
        decoder.SHORT_BLOCK = 0
        columns = best_ns_per_frame(config, live, size, 3)
        print(f"blocks of {size:>4}: frame by frame {scalar:6.0f}, columns {columns:6.0f} ns/frame")


if __name__ == "__main__":
    main()
