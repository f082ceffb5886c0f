"""What a mass on a grade takes, and what the model leaves unexplained of it."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2


def needed_mps2(accel_mps2: FloatColumn, grade: FloatColumn, mu: FloatColumn) -> FloatColumn:
    """Return a + g sin(beta) + g mu cos(beta), the force that 1 kg takes, all columns (n,)."""
    cos = 1.0 / np.sqrt(1.0 + grade * grade)
    return accel_mps2 + GRAVITY_MPS2 * cos * (grade + mu)


def residual_N(
    mass_kg: FloatColumn | float,
    accel_mps2: FloatColumn,
    grade: FloatColumn,
    mu: FloatColumn,
    force_N: FloatColumn,
) -> FloatColumn:
    """Return m (a + g sin(beta) + g mu cos(beta)) - F, all columns (n,)."""
    return mass_kg * needed_mps2(accel_mps2, grade, mu) - force_N
