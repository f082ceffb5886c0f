"""From the filter's states to what is given out: mass, grade, their standard deviations, per window."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2, VehicleFacts
from canest.estimators.canest_0_1 import states as at
from canest.estimators.canest_0_1.prior import ROLLING_SHARE_STD, TORQUE_GAIN_STD

# columns of what is known after a window
MASS_KG, MASS_STD_KG, SINE, SINE_STD, SINE_PER_M, SPEED_MPS, LEARNED, STANDING_S, PROVEN = range(9)
COLUMNS = 9

#: a vehicle that stands longer than at a crossing may be loaded at this very moment
UNLOADED_S = 10.0
#: below this share of the mass its std is that of the inverse mass, to first order
_NARROW = 0.04
#: where a wide posterior is sampled, in standard deviations of the inverse mass
_SAMPLES = np.linspace(-3.0, 3.0, 25)
_WEIGHTS = np.exp(-0.5 * _SAMPLES**2)


def known(
    out: NDArray[np.float64], speed_mps: FloatColumn, facts: VehicleFacts, any_load: float
) -> NDArray[np.float64]:
    """Return what is known after each window, shape (n, COLUMNS), from kernel outputs (n, OUTPUTS).

    any_load: std of the inverse mass when nothing is known of the load, as while it may be changing.
    """
    table = np.empty((len(out), COLUMNS))
    u_var = out[:, at.OUT_U_VAR].copy()
    u_var[out[:, at.OUT_STANDING_S] > UNLOADED_S] += any_load * any_load
    table[:, MASS_KG], table[:, MASS_STD_KG] = mass_of(out[:, at.OUT_U], u_var, facts)
    table[:, SINE] = out[:, at.OUT_GRADE]
    table[:, SINE_PER_M] = out[:, at.OUT_CURVATURE]
    # a tyre that rolls harder looks like a hill, for ever
    rolling = ROLLING_SHARE_STD * facts.rolling_resistance
    # what mass leaves in doubt of the steady force, the hill has to bear
    borne = out[:, at.OUT_UNTOLD] * out[:, at.OUT_STEADY_MPS2] / GRAVITY_MPS2
    grade_var = np.maximum(out[:, at.OUT_GRADE_VAR], 0.0)
    table[:, SINE_STD] = np.minimum(np.sqrt(grade_var + rolling * rolling + borne * borne), 1.0)
    table[:, LEARNED] = out[:, at.OUT_LEARNED]
    table[:, STANDING_S] = out[:, at.OUT_STANDING_S]
    table[:, PROVEN] = out[:, at.OUT_PROVEN]
    table[:, SPEED_MPS] = np.maximum(speed_mps, 0.0)
    return table


def mass_of(u: FloatColumn, u_var: FloatColumn, facts: VehicleFacts) -> tuple[FloatColumn, FloatColumn]:
    """Return mass (kg) and its std for inverse masses u with variance, (n,) each.

    The std covers the gain of the reported torque, which no sample can tell: a torque and a mass 1 % too
    large look the same. An inverse mass that no such vehicle can have is wrong by at least what it is beyond
    the possible: so much is added. A wide posterior of u is lopsided in the mass; there the std is the root
    mean square deviation over the vehicle's range.
    """
    least, most = 1.0 / facts.mass_max_kg, 1.0 / facts.mass_min_kg
    possible = np.clip(u, least, most)
    mass = np.clip(1.0 / possible, facts.mass_min_kg, facts.mass_max_kg)  # or rounding were beyond
    u_std = np.sqrt(np.maximum(u_var, 0.0) + (u - possible) ** 2)
    share = u_std * mass
    wide = np.flatnonzero(share > _NARROW)
    if len(wide):
        # a posterior wider than the vehicle's range is flat on it: samples further apart would all miss it
        flat = u_std[wide] > most - least
        centre = np.where(flat, possible[wide], u[wide])
        samples = centre[:, None] + np.minimum(u_std[wide], most - least)[:, None] * _SAMPLES
        weights = np.where((samples >= least) & (samples <= most), _WEIGHTS, 0.0)
        deviation = 1.0 / np.clip(samples, least, most) - mass[wide, None]
        total = weights.sum(axis=1)
        square = (weights * deviation * deviation).sum(axis=1) / np.maximum(total, 1e-9)
        lopsided = np.sqrt(square) / mass[wide]
        share[wide] = np.where(total > 0.0, np.maximum(lopsided, _NARROW), share[wide])
    std = mass * np.sqrt(share * share + TORQUE_GAIN_STD * TORQUE_GAIN_STD)
    return mass, np.minimum(std, facts.mass_max_kg)
