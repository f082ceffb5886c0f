"""Makes ``tests/data/vcan/cycle.log.xz``: one cycle of a simulated drive that can be played round and round.

A 21 t truck on 1 % grade goes up and down between two speeds every 20 s, so the end of the cycle joins its
beginning; only the wanted groups, and of the fast ones only every other frame, because a guest machine is
emulated. Run by hand when the simulator has changed what a truck sends.
"""

from __future__ import annotations

import lzma
import sys
from collections import Counter
from pathlib import Path

from canest.logs.candump_writer import candump_text
from canest.simulation import simulate

PERIOD_S = 20.0
UP_S = 9.0
SLOW_MPS, FAST_MPS = 13.5, 17.0
#: The first cycles are still settling.
CUT_S = (84.0, 104.0)
MASS_KG, GRADE = 21_000.0, 0.01
#: Frames kept of an identifier: every n-th, 1 where not named.
THINNED = {
    0x0CF00203: 2,
    0x18F0090B: 2,
    0x0CF00300: 2,
    0x18F0000F: 2,
    0x18F00503: 2,
    0x0C000031: 10,
    0x18FE6C31: 10,
}


def main() -> None:
    starts = [40.0 + PERIOD_S * n for n in range(5)]
    drive = simulate(
        {
            "seed": 5,
            "duration_s": 125,
            "vehicle": "class8",
            "mass_kg": MASS_KG,
            "road": {"kind": "points", "at_m": [0, 10_000], "grade": [GRADE, GRADE]},
            "driver": {
                "kind": "given",
                "at_s": [0.0, *(t for start in starts for t in (start, start + UP_S))],
                "speed_mps": [0.0, *(SLOW_MPS, FAST_MPS) * len(starts)],
            },
            "bus": {"loss": 0.0, "traffic": False},
        }
    )
    frames = drive.frames
    since_start_s = (frames.t_us - frames.t_us[0]) * 1e-6
    seen: Counter[int] = Counter()
    keep = []
    for index, can_id in enumerate((frames.can_id & 0x1FFF_FFFF).tolist()):
        if CUT_S[0] <= since_start_s[index] < CUT_S[1]:
            seen[can_id] += 1
            if seen[can_id] % THINNED.get(can_id, 1) == 0:
                keep.append(index)
    path = Path(__file__).parents[1] / "data" / "vcan" / "cycle.log.xz"
    path.write_bytes(lzma.compress(candump_text(frames[keep], "can0")))
    print(f"{path}: {len(keep)} frames, {path.stat().st_size} bytes", file=sys.stderr)


if __name__ == "__main__":
    main()
