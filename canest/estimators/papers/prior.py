"""Start values and noise levels that the papers' methods share."""

from __future__ import annotations

import numpy as np

from canest.core.samples import RATE_HZ, VehicleFacts

#: acceleration noise that scales prior covariances (P is in units of theta^2 per y^2), m/s2
PRIOR_NOISE_MPS2 = 0.05
#: force noise that scales them where the regression is one of forces, N
PRIOR_NOISE_N = 1000.0
#: P never exceeds this multiple of the prior's (2005, section 4.1: limit the growth of the covariance)
P_LIMIT = 10.0
#: step of the running variance of the innovation: a memory of ten seconds
VARIANCE_ALPHA = 1.0 / (10.0 * RATE_HZ)
#: a uniform distribution's width over its standard deviation
SQRT12 = float(np.sqrt(12.0))


def prior_mass_kg(facts: VehicleFacts) -> float:
    """Return the start value of the mass: the user's, else the middle of the bounds."""
    if facts.initial_mass_kg is not None:
        return min(max(facts.initial_mass_kg, facts.mass_min_kg), facts.mass_max_kg)
    return 0.5 * (facts.mass_min_kg + facts.mass_max_kg)


def prior_mass_std_kg(facts: VehicleFacts) -> float:
    """Return the standard deviation of a mass that is anything between the bounds."""
    return (facts.mass_max_kg - facts.mass_min_kg) / SQRT12
