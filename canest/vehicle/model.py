"""The longitudinal model: from held signals to the forces along the road.

    F = k (T - J_e domega/dt) i / r - J_w / r^2 a - F_aero + F_extra          (2005 paper, eq. 1)
    M (a + g sin(beta) + g mu cos(beta)) = F

with the wheels' inertia added and domega/dt = a i / r while the driveline is engaged. k are the losses: eta
where the engine drives, 1 / eta where the wheels drive it (`canest.vehicle.driveline_losses`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from canest.core.columns import constant, shifted
from canest.core.frames import BoolColumn, FloatColumn, IntColumn, MonotonicClock
from canest.core.roles import RADPS_PER_RPM
from canest.core.samples import STEP_S
from canest.grid.grid import GridBlock
from canest.vehicle.driveline_losses import loss_factor
from canest.vehicle.driveline_state import ClutchReports, road_speed_of_engine
from canest.vehicle.effect_call import apply
from canest.vehicle.friction import EngineFriction
from canest.vehicle.gear_ratio import GearRatio
from canest.vehicle.range_rate_check import MAX_SPEED_MPS
from canest.vehicle.role_sources import DRIVEN_SPEEDS, is_at_wheels, ratio_ways, speed_roles, torque_role
from canest.vehicle.spec import ModelSpec
from canest.vehicle.speed_choice import SpeedChoice
from canest.vehicle.torque_fraction import with_fraction
from canest.vehicle.working_columns import ModelColumns

#: specific gas constant of dry air, J/(kg K)
AIR_R = 287.05
#: no road vehicle is pushed harder: a number beyond is damage, and would stay in the filters
MAX_FORCE_N = 1e7
#: slower than this a power shows no torque; the gate low_speed is closed there
_LEAST_MPS, _LEAST_RADPS = 1.0, 10.0
_FRICTION = "engine_friction_pct"


@dataclass(frozen=True, slots=True, eq=False)
class RawModel:
    """The unfiltered model of consecutive ticks, all columns (n,); units as in `ModelBlock`.

    lever_1pm: i / r. crank_force_N, crank_mass_kg: T i / r and J_e (i / r)^2, before the losses.
    usable: every needed number is there. geared: the ratio from crank to wheel is known (or not needed).
    speed_is_shaft: the speed comes from the gearbox's output shaft. speed_is_engine: the finest speed so
    far comes from the engine, through the gear. speed_is_late: it is the road speed of a rare message.
    """

    columns: ModelColumns
    speed_mps: FloatColumn
    lever_1pm: FloatColumn
    crank_force_N: FloatColumn
    crank_mass_kg: FloatColumn
    efficiency: FloatColumn
    force_N: FloatColumn
    traction_N: FloatColumn
    aero_N: FloatColumn
    force_per_torque_1pm: FloatColumn
    rotating_mass_kg: FloatColumn
    wheel_mass_kg: FloatColumn
    usable: BoolColumn
    geared: BoolColumn
    speed_is_shaft: BoolColumn
    speed_is_engine: BoolColumn
    speed_is_late: BoolColumn


class LongitudinalModel:
    """Turns grid blocks into forces; carries the last speed (for differences) and the start of the stream."""

    def __init__(self, spec: ModelSpec) -> None:
        self.vehicle = spec.vehicle
        self.effects = spec.effects
        self.roles = frozenset(spec.roles)
        self.speed_roles = speed_roles(spec.roles, spec.vehicle)
        self.torque_role = torque_role(spec.roles, spec.vehicle)
        #: the torque is measured at the wheels: crank, gear and efficiency do not matter
        self.at_wheels = is_at_wheels(self.torque_role, self.roles)
        self.ratio_ways = ratio_ways(spec.roles, spec.vehicle, self.torque_role)
        self._stages = {
            stage: [e for e in self.effects if e.stage == stage]
            for stage in ("geometry", "crank", "driveline", "speed", "road")
        }
        self._gear_ratio = GearRatio(self.vehicle)
        step = spec.friction_step_pct if "engine_speed" in self.roles else None
        self._friction = None if step is None else EngineFriction(step)
        self._clutch_slip_pct = spec.gates.driveline.clutch_slip_pct
        self._choice = SpeedChoice(self.speed_roles)
        places = {role: k for k, role in enumerate(self.speed_roles)}
        self._late = places.get("vehicle_speed", -1)
        self._shaft = places.get("output_shaft_speed", -1)
        self._engine = places.get("engine_speed", len(places) + 1)
        self._clutch_reports = ClutchReports(self.vehicle)
        self._is_driven = np.array([float(role in DRIVEN_SPEEDS) for role in self.speed_roles])
        self._last_speed_mps = np.nan
        self._monotonic = MonotonicClock()
        self._first_us: int | None = None

    def required_roles(self) -> tuple[str, ...]:
        """Return the roles without which there is no force."""
        torque = {
            "half_shaft_torque_left": ("half_shaft_torque_left", "half_shaft_torque_right"),
        }.get(self.torque_role, (self.torque_role,))
        return torque

    @np.errstate(all="ignore")  # signals may be any float: what is no sane number is not `usable`
    def process(self, grid: GridBlock) -> RawModel:
        """Compute the forces of a block of ticks."""
        if not grid.continues:
            self._last_speed_mps = np.nan
        c = self._columns(grid)
        if self._friction is not None:
            reported, speed = c.signals[_FRICTION], c.engine_radps
            c.signals = {
                **c.signals,
                _FRICTION: self._friction.between_steps(reported, speed, grid.continues),
            }
        geared = c.ratio > 0
        c.ratio = np.where(geared, c.ratio, 0.0)
        self._run("geometry", c)
        self._torque(c)
        self._run("crank", c)
        self._retarder(c)
        self._run("driveline", c)
        if self.at_wheels:  # such torque has had its losses, and has accelerated everything before the wheels
            lever, efficiency = 1.0 / c.radius_m, constant(1.0, len(c))
            crank_force, crank_mass = c.wheel_torque_Nm * lever, constant(0.0, len(c))
        else:
            lever, efficiency, torque = c.ratio / c.radius_m, c.efficiency, c.torque_Nm
            if not self._gear_ratio.has_steps:
                gained = self._gear_ratio.gained(c.ratio, c.engine_radps, grid.continues)
                torque = torque - c.crank_inertia_kgm2 * gained
            crank_force, crank_mass = torque * lever, c.crank_inertia_kgm2 * lever * lever
        # for the slip of the wheels, without which there is no acceleration yet
        c.auxiliary["traction_N"] = loss_factor(crank_force, efficiency) * crank_force
        known = self._clutch_reports.reported(c)
        source, finest = self._speed(c, grid, known)
        speed_is_engine, late = (finest >= self._engine) & known, finest == self._late
        self._run("road", c)
        wheels = c.wheel_inertia_kgm2 / c.radius_m**2
        geared_force = crank_force - crank_mass * c.accel_mps2
        losses = loss_factor(geared_force, efficiency)
        air = c.speed_mps + c.wind_mps
        aero = 0.5 * c.density_kgpm3 * c.drag_area_m2 * air * np.abs(air)
        force = losses * geared_force - wheels * c.accel_mps2 - aero + c.extra_N
        usable = (np.abs(force) <= MAX_FORCE_N) & (np.abs(c.speed_mps) <= MAX_SPEED_MPS)
        geared = geared | self.at_wheels
        return RawModel(
            columns=c,
            speed_mps=c.speed_mps,
            lever_1pm=lever,
            crank_force_N=crank_force,
            crank_mass_kg=crank_mass,
            efficiency=efficiency,
            force_N=force,
            traction_N=losses * crank_force,
            aero_N=aero,
            force_per_torque_1pm=losses * lever,
            rotating_mass_kg=wheels + efficiency * crank_mass,
            wheel_mass_kg=wheels,
            usable=usable,
            geared=geared,
            speed_is_shaft=source == self._shaft,
            speed_is_engine=speed_is_engine,
            speed_is_late=late,
        )

    # -- the steps ---------------------------------------------------------------------------------

    def _run(self, stage: str, c: ModelColumns) -> None:
        for effect in self._stages[stage]:
            apply(effect, c)

    def _columns(self, grid: GridBlock) -> ModelColumns:
        n, v = len(grid), self.vehicle
        monotonic_us = self._monotonic(grid.t_us)  # where the clock was set back, the vehicle drove on
        if self._first_us is None:
            self._first_us = int(monotonic_us[0])
        ratio, gear = self._gear_ratio.of(grid.values, n)
        efficiency = constant(v.driveline_efficiency, n)
        for number, value in v.gear_efficiency.items():
            efficiency = np.where(gear == number, value, efficiency)
        zero = constant(0.0, n)
        return ModelColumns(
            t_us=grid.t_us,
            elapsed_s=(monotonic_us - self._first_us).astype(np.float64) * 1e-6,
            torque_Nm=zero,
            engine_radps=self._engine_radps(grid.values, ratio),
            ratio=ratio * v.final_drive,
            gear=gear,
            radius_m=constant(v.wheel_radius_m, n),
            efficiency=efficiency,
            crank_inertia_kgm2=constant(v.engine_inertia_kgm2, n),
            wheel_inertia_kgm2=constant(v.wheel_inertia_kgm2, n),
            speed_mps=zero,
            accel_mps2=zero,
            wind_mps=zero,
            drag_area_m2=constant(v.drag_area_m2, n),
            density_kgpm3=self._density(grid.values, n),
            mu=constant(v.rolling_resistance, n),
            extra_N=zero,
            wheel_torque_Nm=zero,
            signals=grid.values,
            auxiliary={"nominal_mass_kg": constant((v.mass_min_kg * v.mass_max_kg) ** 0.5, n)},
        )

    def _engine_radps(self, values: Mapping[str, FloatColumn], ratio: FloatColumn) -> FloatColumn:
        """Return the crank's speed; where no role gives it, the speed at which the wheels turn it."""
        if "engine_speed" in values:
            return values["engine_speed"] * RADPS_PER_RPM
        per_mps = self.vehicle.final_drive / self.vehicle.wheel_radius_m * ratio
        speed = constant(math.nan, len(ratio))
        for role in self.speed_roles:
            per_unit = RADPS_PER_RPM * ratio if role == "output_shaft_speed" else per_mps
            speed = np.where(np.isnan(speed), values[role] * per_unit, speed)
        return speed

    def _density(self, values: Mapping[str, FloatColumn], n: int) -> FloatColumn:
        pressure, temperature = values.get("barometric_pressure"), values.get("ambient_temperature")
        declared = constant(self.vehicle.air_density_kgpm3, n)
        if pressure is None or temperature is None:
            return declared
        density = 1000.0 * pressure / (AIR_R * (temperature + 273.15))
        plausible = (density > 0.5) & (density < 1.7)
        return np.where(plausible, density, declared)

    def _torque(self, c: ModelColumns) -> None:
        """Set net crank torque (or wheel torque): (actual - friction) % x reference."""
        role = self.torque_role
        if role == "wheel_force":  # the radius that turns it into a torque turns it back
            c.wheel_torque_Nm = c.signals[role] * c.radius_m
        elif role == "power":
            self._torque_of_power(c)
        elif role == "wheel_torque":
            c.wheel_torque_Nm = c.signals[role]
        elif role == "half_shaft_torque_left":
            c.wheel_torque_Nm = c.signals[role] + c.signals["half_shaft_torque_right"]
        elif role == "engine_torque":
            c.torque_Nm = c.signals[role]
        else:
            declared = self.vehicle.reference_torque_Nm
            reference = c.signal("reference_torque", np.nan if declared is None else declared)
            friction = c.signal(_FRICTION, self.vehicle.friction_torque_pct)
            c.torque_Nm = (with_fraction(c.signals) - friction) * 0.01 * reference

    def _retarder(self, c: ModelColumns) -> None:
        """Add what a reported retarder takes; behind the effects on the engine's torque, which is not its."""
        retarder = self.vehicle.retarder
        # torque measured at the wheels already has what a retarder takes
        if retarder is not None and "retarder_torque_pct" in self.roles and not self.at_wheels:
            reference = c.signal("retarder_reference_torque", retarder.reference_torque_Nm)
            torque = 0.01 * c.signal("retarder_torque_pct") * reference  # SPN 520 is negative while braking
            if retarder.location == "crank":
                c.torque_Nm = c.torque_Nm + torque
            else:
                c.extra_N = c.extra_N + torque * self.vehicle.final_drive / c.radius_m

    def _torque_of_power(self, c: ModelColumns) -> None:
        """Set the torque by T = P / omega, at the wheels where no role gives the engine's speed."""
        watts = 1000.0 * c.signals["power"]
        if not self.at_wheels:
            c.torque_Nm = watts / np.maximum(c.engine_radps, _LEAST_RADPS)
            return
        speed = constant(math.nan, len(c))
        for role in self.speed_roles:
            speed = np.where(np.isnan(speed), self.speed_of(role, c), speed)
        c.wheel_torque_Nm = watts / np.maximum(speed, _LEAST_MPS) * c.radius_m

    def speed_of(self, role: str, c: ModelColumns, known: BoolColumn | bool = True) -> FloatColumn:
        """Return the speed that a role gives, m/s (n,). known: where the state of the clutch is reported."""
        if role == "output_shaft_speed":
            return c.signals[role] * (RADPS_PER_RPM / self.vehicle.final_drive) * c.radius_m
        if role == "engine_speed":
            return np.where(known, road_speed_of_engine(c, self._clutch_slip_pct), np.nan)
        if role == "vehicle_speed":  # counted at the wheels (SPN 84), with the radius that was declared
            return c.signals[role] * (c.radius_m / self.vehicle.wheel_radius_m)
        return c.signals[role]

    def _speed(self, c: ModelColumns, ticks: GridBlock, known: BoolColumn) -> tuple[IntColumn, IntColumn]:
        """Set speed and acceleration, from the finest speed that can be relied on.

        Return which that is, and the finest received so far, as positions in `speed_roles` (n,).
        """
        c.speed_mps, source, finest = self._choice.choose(
            [partial(self.speed_of, role, c, known) for role in self.speed_roles], ticks
        )
        c.auxiliary["driven"] = self._is_driven[source]
        self._run("speed", c)
        speed = c.speed_mps
        before = shifted(speed, self._last_speed_mps)
        c.accel_mps2 = np.where(np.isnan(before), 0.0, speed - before) / STEP_S
        self._last_speed_mps = float(speed[-1])
        return source, finest
