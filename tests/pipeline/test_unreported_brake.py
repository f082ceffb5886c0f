"""Short full-throttle runs ended by a brake that no signal reports: nothing wrong is valid."""

from __future__ import annotations

import numpy as np
import pytest
from launches import CONFIG, MASS_KG, launches

import canest
from canest.config.schema import Config

STEEPEST = 0.06  #: the roads of these runs have 1 % rms


@pytest.mark.parametrize("estimator", ["canest-0.1", "canest"])
@pytest.mark.parametrize("seed", range(4))
def test_braking_that_nothing_reports_is_neither_weight_nor_a_hill(estimator: str, seed: int) -> None:
    config = Config.model_validate(CONFIG | {"estimator": {"name": estimator}})
    result = canest.estimate(launches(seed), config)
    mass_kg, grade = np.asarray(result.mass_kg), np.asarray(result.grade)
    valid = np.asarray(result.status) == 2
    assert np.all(np.abs(mass_kg[valid] / MASS_KG - 1.0) < 0.08)
    assert np.nanmax(np.abs(grade)) < STEEPEST
    assert abs(mass_kg[-1] - MASS_KG) < 3.0 * result.mass_std_kg[-1]
    assert result.summary["gates"]["possible_brake"] > 0


def test_the_same_runs_with_the_gate_off_show_what_it_is_for() -> None:
    gates = {"possible_brake": {"enabled": False}}
    result = canest.estimate(launches(1), Config.model_validate(CONFIG | {"gates": gates}))
    assert np.nanmax(np.abs(result.grade)) > STEEPEST
