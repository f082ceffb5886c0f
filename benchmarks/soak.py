"""A day of driving fed at full speed through the whole daemon: does it grow?

    python benchmarks/soak.py [--hours 24] [--estimator canest]

The bus and the clock are scripted, everything else is the daemon as it runs in a vehicle: recording into the
bounded ring, saving, metrics, broadcast, address claim. The drive is simulated, 10 minutes, over and over,
with a stop of the bus in between. Prints memory and file descriptors every simulated hour; exit code 1 when
memory grows by 2 MB or more after the first ten minutes, or any descriptor is left open.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from canest.config import load_config
from canest.simulation.reading import load_scenario
from canest.simulation.run import simulate
from tests.live.rig import Rig, descriptors, resident_kb

DRIVE_S, STOP_S = 600.0, 20.0
WARM_S = 600.0
LIMIT_MB = 2.0


class Patch:
    """What pytest's monkeypatch does for the rig, without taking it back."""

    def setattr(self, owner: object, name: str, value: object) -> None:
        setattr(owner, name, value)


def resident_mb() -> float:
    return resident_kb() / 1024


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--estimator", default="canest")
    arguments = parser.parse_args()
    scenario = load_scenario("mixed-36t").model_copy(update={"duration_s": DRIVE_S})
    frames = simulate(scenario).frames
    with tempfile.TemporaryDirectory() as folder:
        ring = Path(folder, "ring")
        changes = [
            "service.learn='on+save'",
            "service.residual_max_mb=5",
            f"estimator.name={arguments.estimator}",
        ]
        for key, name in (("state_dir", ""), ("metrics_file", "m.prom"), ("residual_dir", "ring")):
            changes.append(f"service.{key}={folder}/{name}")
        config = load_config("vcan", changes)
        with Rig(Patch(), config, frames) as rig:
            warm: tuple[float, int] | None = None
            begin, passed_s, printed_h = time.monotonic(), 0.0, 0
            while passed_s < arguments.hours * 3600:
                rig.script.repeat(rig.now_us)
                rig.run(DRIVE_S + STOP_S)
                rig.daemon.background.flush(10)
                passed_s += DRIVE_S + STOP_S
                if warm is None and passed_s >= WARM_S:
                    warm = resident_mb(), descriptors(ring)
                if warm is not None and passed_s >= printed_h * 3600:
                    printed_h += 1
                    learned = rig.daemon.estimation.mass_store.learned
                    counted = rig.daemon.pipeline.decoder.counters
                    print(
                        f"{passed_s / 3600:5.1f} h: {resident_mb():.1f} MB ({resident_mb() - warm[0]:+.2f}), "
                        f"{descriptors(ring)} descriptors, {counted.frames:,} frames, "
                        f"learned {learned.mass_kg if learned else 0:,.0f} kg, "
                        f"failures {rig.daemon.estimation.failures}, {time.monotonic() - begin:.0f} s",
                        flush=True,
                    )
            assert warm is not None
            grown, opened = resident_mb() - warm[0], descriptors(ring) - warm[1]
            recorded = sum(p.stat().st_size for p in ring.iterdir())
    print(f"{passed_s / 3600:.1f} h: {grown:+.2f} MB, {opened:+d} descriptors, ring {recorded / 1e6:.1f} MB")
    return 1 if grown >= LIMIT_MB or opened > 0 else 0


if __name__ == "__main__":
    sys.exit(main())
