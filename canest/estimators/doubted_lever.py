"""What is left of an estimate where speeds of the bus contradict the declared gearing or wheel radius."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import EstimateBlock, Status


def widened(estimates: EstimateBlock, lever_std: FloatColumn | None, valid_std: float) -> EstimateBlock:
    """Return n estimates with the standard deviation of ratio and radius in theirs.

    No mass is valid whose standard deviation is then above the share ``valid_std`` of it.
    lever_std: see `ModelBlock`.
    """
    if lever_std is None or not lever_std.any():  # nearly always
        return estimates
    mass = estimates.mass_kg
    mass_std = np.hypot(estimates.mass_std_kg, mass_share(lever_std) * mass)
    doubted = (lever_std > 0.0) & (mass_std > valid_std * mass) & (estimates.status == Status.VALID)
    return replace(
        estimates,
        mass_std_kg=mass_std,
        grade_std=np.hypot(estimates.grade_std, lever_std * estimates.grade),
        status=np.where(doubted, np.uint8(Status.CONVERGING), estimates.status),
    )


def mass_share(lever_std: FloatColumn) -> FloatColumn:
    """Return the std of the mass as a share: M = F / a, with F proportional to 1 / r and a to r."""
    return 2.0 * lever_std
