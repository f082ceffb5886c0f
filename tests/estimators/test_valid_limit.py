"""`estimator.valid_std_pct`: how small a standard deviation the user calls good enough."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from canest.core.samples import Status
from canest.estimators.registry import create

from .momentum import FACTS, trip

STATED = replace(FACTS, torque_accuracy=0.005, wheel_radius_accuracy=0.001)


@pytest.fixture(scope="module")
def drive():
    return trip(180.0)


def estimates(drive, **facts):
    return create("canest", replace(STATED, **facts)).update(drive.block)


@pytest.mark.parametrize("limit", [0.016, 0.02, 0.045])
def test_no_valid_mass_has_a_larger_std_than_the_user_allows(drive, limit):
    found = estimates(drive, valid_std=limit)
    valid = found.status == Status.VALID
    assert valid.any()
    assert np.all(found.mass_std_kg[valid] <= limit * found.mass_kg[valid])


def test_a_stricter_limit_makes_valid_later_and_changes_no_number(drive):
    usual, strict = estimates(drive), estimates(drive, valid_std=0.02)
    first = [int(np.argmax(e.status == Status.VALID)) for e in (usual, strict)]
    assert 0 < first[0] < first[1]
    for column in ("mass_kg", "mass_std_kg", "grade", "grade_std"):
        np.testing.assert_array_equal(getattr(usual, column), getattr(strict, column))


def test_a_limit_that_no_drive_reaches_is_never_valid(drive):
    assert not np.any(estimates(drive, valid_std=1e-4).status == Status.VALID)


@pytest.mark.parametrize("name", ["rls", "ekf"])
def test_the_papers_methods_use_neither_accuracies_nor_the_limit(drive, name):
    usual = create(name, FACTS).update(drive.block)
    other = create(
        name,
        replace(
            FACTS,
            torque_accuracy=0.2,
            wheel_radius_accuracy=0.1,
            rolling_resistance_accuracy=0.5,
            drag_area_accuracy=0.5,
            valid_std=0.001,
        ),
    ).update(drive.block)
    for column in ("mass_kg", "mass_std_kg", "grade", "grade_std", "status"):
        np.testing.assert_array_equal(getattr(usual, column), getattr(other, column))
