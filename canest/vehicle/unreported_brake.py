"""Where a vehicle may be braking, if no signal reports its brakes.

M a = F - B - M g (sin(beta) + mu cos(beta)): a brake force B that nobody reports is a hill, or more mass.
While the vehicle is not driven and the accelerator is not known to be pressed, B may be anything, and nothing
is to be learned from its deceleration. Otherwise a driver seldom brakes; what remains is found where no road
is steep enough.
"""

from __future__ import annotations

from canest.core.frames import BoolColumn, FloatColumn
from canest.core.roles import BRAKES, PEDAL
from canest.core.samples import GRAVITY_MPS2
from canest.vehicle.model import RawModel
from canest.vehicle.spec import ModelSpec


class UnreportedBrake:
    """Finds samples on which a brake may act."""

    def __init__(self, spec: ModelSpec) -> None:
        section, vehicle = spec.gates.possible_brake, spec.vehicle
        self._least_N = section.propulsion_mps2 * vehicle.mass_min_kg
        self._mass_max_kg = vehicle.mass_max_kg
        self._steepest_mps2 = section.steepest_grade * GRAVITY_MPS2

    @staticmethod
    def possible(spec: ModelSpec) -> bool:
        """Return whether no role reports the brakes, and no released accelerator stands for them."""
        stands_for = spec.gates.brake.assume_when_pedal_released and PEDAL in spec.roles
        return not stands_for and not any(role in spec.roles for role in BRAKES)

    def may_act(self, raw: RawModel, accel_mps2: FloatColumn, pressed: BoolColumn) -> BoolColumn:
        """Return where a brake may act (n,). accel_mps2: filtered acceleration. pressed: the accelerator.

        Where the traction is not known, another gate is closed. With a positive force the least grade that
        the motion needs is that of the heaviest vehicle.
        """
        c = raw.columns
        force_N = raw.traction_N - raw.rotating_mass_kg * accel_mps2 - raw.aero_N + c.extra_N
        climbs_mps2 = force_N / self._mass_max_kg - accel_mps2 - GRAVITY_MPS2 * c.mu
        may: BoolColumn = (~pressed & (raw.traction_N < self._least_N)) | (climbs_mps2 > self._steepest_mps2)
        return may
