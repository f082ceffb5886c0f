"""Trucks that send little: a load that changes in a stop is found, and no wrong mass is valid."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from canest.config import load_config, parse_config, read_databases
from canest.core.samples import Status
from canest.simulation.reading import load_scenario
from canest.simulation.run import simulate
from canest.system.shipped_files import shipped

from .attacks import estimated

pytestmark = pytest.mark.usefixtures("compiled")

SHAFTS = ("output_shaft_speed", "undriven_speed")
CLUTCH_ROLES = ("shift_in_process", "driveline_engaged", "lockup_engaged", "clutch_slip")
ETC1, ETC2, EBC2, VDC2 = 0xF002, 0xF005, 0xFEBF, 0xF009  #: PGN
MORE = ("gear_ratio", "gear", "longitudinal_accel", "yaw_rate", "altitude")


def without(*roles: str):
    text = (shipped("configs") / "class8.yaml").read_text()
    text = re.sub(rf"(?m)^  ({'|'.join(roles)}):.*\n", "", text)
    return read_databases(parse_config(text, str(Path("class8.yaml"))))


@pytest.fixture(scope="module")
def drive():
    scenario = load_scenario("city-payload")
    return simulate(scenario.model_copy(update={"duration_s": 460.0}))


@pytest.mark.parametrize(
    "silent",
    [SHAFTS, (*SHAFTS, "vehicle_speed"), (*SHAFTS, *CLUTCH_ROLES), (*SHAFTS, *CLUTCH_ROLES, *MORE)],
    ids=["no shaft", "engine speed only", "no word of the clutch", "EEC1 and CCVS1 only"],
)
def test_a_change_of_load_is_found(drive, silent):
    judge(drive, without(*silent), drive.frames)


@pytest.mark.parametrize("unsent", [(ETC1,), (ETC1, EBC2), (ETC1, ETC2, EBC2, VDC2)])
def test_a_change_of_load_is_found_where_what_is_mapped_is_never_sent(drive, unsent):
    received = ~np.isin((drive.frames.can_id.astype(np.int64) >> 8) & 0x3FFFF, unsent)
    judge(drive, load_config("class8"), drive.frames[received])


def judge(drive, config, frames):
    """Require a mass that is right before and after the change, and none that is valid and wrong."""
    _, e = estimated(config, frames)
    t = e.t_us * 1e-6
    mass = drive.truth["mass_kg"][np.searchsorted(drive.truth["t_s"], t, side="right") - 1]
    error = np.abs(e.mass_kg / mass - 1.0)
    assert (error[e.status == Status.VALID] > 0.08).mean() < 0.01
    before = mass == mass[0]
    last_valid = error[before & (e.status == Status.VALID)][-1]  # stops before the change leave it in doubt
    assert last_valid < 0.05 and error[-1] < 0.05
    assert mass[0] != mass[-1]
