"""Cost of decoding: nanoseconds per frame in long blocks, microseconds per live block of 20 ms.

Usage: python benchmarks/decode.py [LOG.xz]   (default: the bundled Kenworth log, repeated to a few minutes)
"""

from __future__ import annotations

import itertools
import statistics
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "decode"))

from decode_helpers import frames_of_log, shipped_database, wants

from canest.decode import Decoder, decoder
from canest.frames import FrameBlock

ROLES = wants(
    ("engine_torque_pct", "EEC1", "ActualEngPercentTorque", 0),
    ("engine_speed", "EEC1", "EngSpeed", 0),
    ("accelerator", "EEC2", "AccelPedalPos1", 0),
    ("engine_friction_pct", "EEC3", "NominalFrictionPercentTorque", 0),
    ("reference_torque", "EC1", "EngReferenceTorque", 0),
    ("output_shaft_speed", "ETC1", "Trans1OutputShaftSpeed", 3),
    ("driveline_engaged", "ETC1", "TransDrivelineEngaged", 3),
    ("shift_in_process", "ETC1", "TransShiftInProcess", 3),
    ("gear_ratio", "ETC2", "TransActualGearRatio", 3),
    ("retarder_torque_pct", "ERC1", "ActualRetarderPercentTorque", 15),
    ("vehicle_speed", "CCVS1", "WheelBasedVehicleSpeed", 0),
    ("brake_switch", "CCVS1", "BrakeSwitch", 0),
    ("undriven_speed", "EBC2", "FrontAxleSpeed", 11),
    ("longitudinal_accel", "VDC2", "LongitudinalAcceleration", 11),
    ("ambient_temperature", "AMB", "AmbientAirTemp", 0),
)


def best_ns_per_frame(block: FrameBlock, size: int, repeats: int = 7) -> float:
    """Return the best of some runs over the block in pieces of ``size`` frames."""
    best = float("inf")
    pieces = [block[i : i + size] for i in range(0, len(block), size)]
    for _ in range(repeats):
        fresh = Decoder(ROLES, [shipped_database()])
        fresh.push(block[:200])  # senders and identifiers known, as after the first second
        start = time.perf_counter()
        for piece in pieces:
            fresh.push(piece)
        best = min(best, time.perf_counter() - start)
    return best / len(block) * 1e9


def main() -> None:
    """Measure and print."""
    frames = frames_of_log(sys.argv[1] if len(sys.argv) > 1 else "kenworth/normal.log.xz")
    one = FrameBlock.from_frames(list(frames))
    copies = max(1, 400_000 // len(one))
    long = FrameBlock.concatenate([one] * copies)
    print(f"{len(long)} frames, {len(ROLES)} roles")
    for size in (1_000_000, 100_000, 10_000, 1_000):
        print(f"blocks of {size:>7}: {best_ns_per_frame(long, size):6.1f} ns/frame")
    live = one[: min(len(one), 40_000)]
    edges = np.searchsorted(live.t_us, np.arange(live.t_us[0], live.t_us[-1], 20_000))
    pieces = [live[a:b] for a, b in itertools.pairwise(edges)]
    for name, short in (("frame by frame", 10**9), ("in columns", 0)):
        decoder.SHORT_BLOCK = short
        fresh = Decoder(ROLES, [shipped_database()])
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
        scalar = best_ns_per_frame(live, size, 3)
        decoder.SHORT_BLOCK = 0
        columns = best_ns_per_frame(live, size, 3)
        print(f"blocks of {size:>4}: frame by frame {scalar:6.0f}, columns {columns:6.0f} ns/frame")


if __name__ == "__main__":
    main()
