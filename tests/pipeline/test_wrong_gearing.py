"""A radius or final drive that the bus contradicts: no mass is valid, and the std covers its error."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import load_config
from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.core.samples import Status
from canest.demo import DRIVE
from canest.logs import open_log
from canest.pipeline.pipeline import Pipeline

pytestmark = pytest.mark.usefixtures("compiled")


@pytest.fixture(scope="module")
def frames() -> FrameBlock:
    return FrameBlock.concatenate([block for block in open_log(DRIVE) if isinstance(block, FrameBlock)])


def driven(frames: FrameBlock, estimator: str, *changes: str) -> tuple[Estimates, Pipeline]:
    pipeline = Pipeline(load_config("class8", [f"estimator.name={estimator}", *changes]))
    return Estimates.concatenate([pipeline.push(frames), pipeline.finish()]), pipeline


@pytest.mark.parametrize("estimator", ["canest", "canest-0.1", "ekf", "rlsmf"])
@pytest.mark.parametrize(
    "change", ["vehicle.wheel_radius_m=0.44", "vehicle.wheel_radius_m=0.56", "vehicle.final_drive=4.2"]
)
def test_a_wrong_fact_of_the_gearing_leaves_no_valid_mass(
    frames: FrameBlock, estimator: str, change: str
) -> None:
    right, _ = driven(frames, estimator)
    wrong, pipeline = driven(frames, estimator, change)
    compared = np.arange(len(wrong)) > 60 * 50
    assert np.mean(wrong.status[compared] == Status.VALID) < 0.01
    if estimator == "canest":
        assert np.mean(right.status[compared] == Status.VALID) > 0.9
    off = np.abs(wrong.mass_kg - right.mass_kg)[compared]
    assert np.all((off <= 2.0 * wrong.mass_std_kg[compared]) | np.isnan(off))
    kept = pipeline.snapshot()
    if kept:
        assert kept["mass_std_kg"] >= 0.99 * wrong.mass_std_kg[-1]


def test_a_wrong_factor_of_another_speed_is_doubt_as_well(frames: FrameBlock) -> None:
    wrong, _ = driven(frames, "canest", "signals.undriven_speed.scale=1.08")
    assert np.mean(wrong.status[60 * 50 :] == Status.VALID) < 0.01
