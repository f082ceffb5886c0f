"""One simulated drive for all live tests, and the real logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from canest.core.frames import EXTENDED, FrameBlock

VDHR_ID = 0x18FEC1EE | EXTENDED  #: vehicle distance in high resolution
ODOMETER_START_KM = 100_000.0
DATA = Path(__file__).resolve().parent.parent / "data"


@pytest.fixture(scope="session")
def data():
    return DATA


@pytest.fixture(scope="session")
def drive():
    """A minute and a half of the demonstration drive: the mass is valid after half a minute."""
    from canest.simulation.reading import load_scenario
    from canest.simulation.run import simulate

    scenario = load_scenario("demo")
    drive = simulate(scenario.model_copy(update={"duration_s": 90.0}))
    frames = drive.frames
    distance_m = np.interp(frames.t_us * 1e-6, drive.truth["t_s"], drive.truth["distance_m"])
    counted = ((ODOMETER_START_KM + distance_m * 1e-3) / 0.005).astype(np.uint64)
    odometer = frames.can_id == np.uint32(VDHR_ID)  # random bytes in the simulation
    data = np.where(odometer, counted | np.uint64(0xFFFF_FFFF_0000_0000), frames.data)
    return FrameBlock(frames.t_us, frames.can_id, frames.length, data)
