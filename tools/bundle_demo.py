"""Makes the drive that `canest demo` plays: scenario `demo`, the frames that class8's filters let through."""

from __future__ import annotations

import lzma
import tempfile
from pathlib import Path

from canest.config import load_config
from canest.core.frames import FrameBlock
from canest.logs.candump_writer import candump_text
from canest.logs.format_detection import open_log
from canest.pipeline.signal_map import decoder_for
from canest.simulation.run import simulate_to_directory

TARGET = Path(__file__).resolve().parent.parent / "canest" / "demo"
PRESET = 9 | lzma.PRESET_EXTREME


def main() -> None:
    """Simulate, select, compress."""
    decoder = decoder_for(load_config("class8"))
    with tempfile.TemporaryDirectory() as folder:
        simulate_to_directory("demo", folder)
        blocks = [b for b in open_log(Path(folder) / "demo.log") if isinstance(b, FrameBlock)]
        frames = decoder.select(FrameBlock.concatenate(blocks))
        truth = (Path(folder) / "demo.truth.csv").read_bytes()
    (TARGET / "drive.log.xz").write_bytes(lzma.compress(candump_text(frames), preset=PRESET))
    (TARGET / "drive.truth.csv.xz").write_bytes(lzma.compress(truth, preset=PRESET))


if __name__ == "__main__":
    main()
