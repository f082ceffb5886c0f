"""What the model leaves unexplained of a mass and a grade, as a force."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2


def residual_N(
    mass_kg: FloatColumn | float,
    accel_mps2: FloatColumn,
    grade: FloatColumn,
    mu: FloatColumn,
    force_N: FloatColumn,
) -> FloatColumn:
    """Return m (a + g sin(beta) + g mu cos(beta)) - F, all columns (n,)."""
    cos = 1.0 / np.sqrt(1.0 + grade * grade)
    return mass_kg * (accel_mps2 + GRAVITY_MPS2 * cos * (grade + mu)) - force_N
