"""A bundled drive with its truth, and the session that plays it to the daemon.

`drive.log.xz` is a recording of three minutes of the simulator's scenario `demo` (21 t, throttle pulses,
shifts, hills, and the small undeclared errors that every truck has): the frames that the filters of
`configs/class8.yaml` let through. `tools/bundle_demo.py` makes it anew, by the simulator as it is then.
"""

from __future__ import annotations

from pathlib import Path

DRIVE = Path(__file__).resolve().parent / "drive.log.xz"
TRUTH = Path(__file__).resolve().parent / "drive.truth.csv.xz"
