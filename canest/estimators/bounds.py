"""What the bounds of the mass say: when the driving contradicts one, and what an unseen stop may change."""

from __future__ import annotations

import math

from canest.core.samples import VehicleFacts

#: 99.9 % of a normal density lie below so many standard deviations
SIGNIFICANT = 3.09
#: nothing weighs so many times the heaviest mass: the force has nothing to do with the speed
_NO_VEHICLE = 4.0
#: a stop that nobody saw may have changed the load: this share of the spread of an unknown one at once,
#: growing with the time to all of it
STOP_SHARE, STOP_TIME_S = 0.05, 8 * 3600.0


def gain_std(facts: VehicleFacts) -> float:
    """Return the std of the mass, as a share, that no driving takes away.

    M = F / a, F proportional to torque / radius, a to the radius: the radius counts twice.
    """
    return math.hypot(facts.torque_accuracy, 2.0 * facts.wheel_radius_accuracy)


def unseen_std_kg(unseen_s: float, facts: VehicleFacts) -> float:
    """Return what an unseen stop adds to the std of a mass, for an estimator with one density."""
    if unseen_s <= 0.0:
        return 0.0
    share = max(STOP_SHARE, 1.0 - math.exp(-unseen_s / STOP_TIME_S))
    return share * (facts.mass_max_kg - facts.mass_min_kg) / math.sqrt(12.0)


def beyond_bound(u: float, u_var: float, facts: VehicleFacts) -> str:
    """Return the bound of the mass beyond which the driving leads, in a sentence ('' for none).

    P(mass beyond the bound) > 99.9 %, where the mass has the posterior's variance and that of its gain.
    Enough has been learned where the posterior alone is, by its own mean, as narrow as that of a valid mass:
    a speed that does not follow the force at all makes a mass without end, and shows nothing of a vehicle. It
    is named instead, where the inverse mass is known to be that small.

    u, u_var: mean and variance of the inverse mass without bounds and without the gain's, 1/kg and 1/kg2.
    """
    least_u = 1.0 / facts.mass_max_kg
    if u < least_u / _NO_VEHICLE and u_var < (facts.valid_std * least_u) ** 2:
        return (
            "the speed hardly follows the torque, as if the vehicle weighed many times vehicle.mass_max_kg = "
            f"{facts.mass_max_kg:,.0f} kg: is the torque another signal, or its factor or unit wrong?"
        )
    if u <= 0.0 or u_var > (facts.valid_std * u) ** 2:
        return ""
    gain = gain_std(facts)
    for bound, is_so, bound_kg, side in (
        ("mass_max_kg", "heavier", facts.mass_max_kg, 1.0),
        ("mass_min_kg", "lighter", facts.mass_min_kg, -1.0),
    ):
        # as shares of the bound's own inverse mass
        beyond, var = side * (1.0 - u * bound_kg), u_var * bound_kg * bound_kg
        if beyond > SIGNIFICANT * math.sqrt(var + gain * gain):
            return (
                f"the driving shows a vehicle {is_so} than vehicle.{bound} = {bound_kg:,.0f} kg: "
                "the bound is wrong, or torque, ratio or wheel radius are"
            )
    return ""
