"""What is left of an estimate where speeds of the bus contradict the declared gearing or wheel radius."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import EstimateBlock, Status

Column = TypeVar("Column", FloatColumn, float)


def widened(estimates: EstimateBlock, lever_std: FloatColumn | None, valid_std: float) -> EstimateBlock:
    """Return n estimates with the standard deviation of ratio and radius in theirs.

    No mass is valid whose standard deviation is then above the share ``valid_std`` of it.
    lever_std: see `ModelBlock`.
    """
    if lever_std is None or not lever_std.any():  # nearly always
        return estimates
    mass = estimates.mass_kg
    mass_std = widened_std_kg(estimates.mass_std_kg, mass, lever_std)
    doubted = (lever_std > 0.0) & (mass_std > valid_std * mass) & (estimates.status == Status.VALID)
    return replace(
        estimates,
        mass_std_kg=mass_std,
        grade_std=np.hypot(estimates.grade_std, lever_std * estimates.grade),
        status=np.where(doubted, np.uint8(Status.CONVERGING), estimates.status),
    )


def widened_std_kg(mass_std_kg: Column, mass_kg: Column, lever_std: Column) -> Column:
    """Return the std with that of ratio and radius in it: M = F / a, with F ~ 1 / r and a ~ r."""
    wider: Column = np.hypot(mass_std_kg, 2.0 * lever_std * mass_kg)
    return wider
