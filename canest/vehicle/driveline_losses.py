"""What the driveline's losses make of the crank's torque and of its inertia.

    F = k (T - J domega/dt) i / r,   k = eta where T - J domega/dt >= 0, else 1 / eta

T - J domega/dt is the torque that enters the gearbox, and domega/dt = a i / r. In overrun the wheels change
the crank's speed through the same losses: its equivalent mass is J i^2 / (eta r^2), not eta J i^2 / r^2.
"""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn


def loss_factor(geared_N: FloatColumn, efficiency: FloatColumn) -> FloatColumn:
    """Return k (n,). geared_N: (T - J domega/dt) i / r, positive where the engine drives.

    k jumps where the power changes its direction; k x geared_N does not, as it is zero there.
    """
    return np.where(geared_N < 0, 1.0 / efficiency, efficiency)
