"""Golden replays: what the recorded logs gave when this was last looked at by a person.

``python tests/replay/golden.py --write`` makes them anew; whoever does says why in the commit.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np

from canest.config import load_config
from canest.core.estimates import Estimates
from canest.demo import DRIVE
from canest.offline.log_run import LogRun

HERE = Path(__file__).resolve().parent
FILE = HERE / "golden.json"
KENWORTH = HERE.parent / "data" / "kenworth" / "normal.log.xz"
#: name -> (log, config, estimator)
CASES: dict[str, tuple[Path, str, str]] = {
    f"{log.parent.name}-{estimator}": (log, config, estimator)
    for log, config in ((KENWORTH, "kenworth"), (DRIVE, "class8"))
    for estimator in ("canest", "rlsmf", "ekf")
}
EVERY = 250  #: one row in five seconds


def replayed(log: Path, config: str, estimator: str) -> Estimates:
    """Replay in this process, interpreted."""
    run = LogRun(log, load_config(config, [f"estimator.name={estimator}"]))
    return Estimates.concatenate(list(run.estimates()))


def digest(estimates: Estimates) -> dict[str, Any]:
    """Return one row in `EVERY`, null where there is no number, and how often each gate was closed."""

    def column(values: np.ndarray) -> list[float | None]:
        return [None if math.isnan(v) else float(f"{v:.9g}") for v in values[::EVERY].tolist()]

    return {
        "samples": len(estimates),
        "t_us": estimates.t_us[::EVERY].tolist(),
        "mass_kg": column(estimates.mass_kg),
        "mass_std_kg": column(estimates.mass_std_kg),
        "grade": column(estimates.grade),
        "status": estimates.status[::EVERY].tolist(),
        "gates": {str(code): int(n) for code, n in enumerate(np.bincount(estimates.gate).tolist()) if n},
    }


def main() -> None:
    """Write or show the digests."""
    text = json.dumps({name: digest(replayed(*case)) for name, case in CASES.items()}, indent=1) + "\n"
    if "--write" in sys.argv:
        FILE.write_text(text)
    else:
        print(text)


if __name__ == "__main__":
    main()
