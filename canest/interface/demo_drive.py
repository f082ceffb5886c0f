"""The drive that ships with canest, as a simulated drive."""

from __future__ import annotations

import numpy as np

from canest.config import load_config
from canest.core.frames import FrameBlock
from canest.core.table_block import TableBlock
from canest.demo import DRIVE, TRUTH
from canest.interface.simulated_drive import SimulatedDrive, simulated_drive_of
from canest.logs.format_detection import open_log
from canest.simulation.drive import SimulatedDrive as Made

_CONFIG = "class8"


def demo_drive() -> SimulatedDrive:
    """Read the bundled frames and their truth."""
    frames = [block for block in open_log(DRIVE) if isinstance(block, FrameBlock)]
    tables = [block for block in open_log(TRUTH) if isinstance(block, TableBlock)]
    truth = {"t_s": np.concatenate([table.t_us for table in tables]) / 1e6}
    for name in tables[0].columns:
        truth[name] = np.concatenate([table.columns[name] for table in tables])
    config = load_config(_CONFIG).model_dump(mode="json", exclude_unset=True)
    return simulated_drive_of(Made("demo", FrameBlock.concatenate(frames), truth, config, [], {}))
