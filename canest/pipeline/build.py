"""Translates a config into what each stage needs; no module below imports `Config`.

    config -> IntakeSpec, GridSpec, ModelSpec, EstimatorSpec, assumed constants

Each is small and frozen, so that a stage can be built and tested by hand.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

from canest.config.schema import Config
from canest.config.sections import SLOWEST_ACCELEROMETER_S
from canest.core.errors import ConfigError
from canest.core.roles import ROLES, conversion
from canest.core.samples import VehicleFacts
from canest.decode.groups import Want
from canest.estimators.base import Estimator
from canest.estimators.registry import create
from canest.grid.grid import FOREVER_US, Channel, behind_us
from canest.pipeline.assumed_constants import AssumedConstants
from canest.pipeline.signal_map import factor_and_offset, resolution_of, step_of, unit_of, wants_of
from canest.pipeline.signal_timing import between_of, hold_us, stale_limit_s, wait_us
from canest.vehicle.butterworth import butterworth, delay_s
from canest.vehicle.range_rate_check import JUMP, JUMP_HOLD_S, MOTION_JUMP, Limit, limits_of
from canest.vehicle.role_sources import (
    AT_WHEELS,
    DRIVEN_SPEEDS,
    is_at_wheels,
    motion_roles,
    ratio_ways,
    speed_in_use,
    speed_roles,
    torque_role,
)
from canest.vehicle.spec import AccelerometerSource, FilterSpec, ModelSpec
from canest.vehicle.torque_dropout import LIMITED, TorqueLimit, torque_limits

if TYPE_CHECKING:
    from cantools.database.can import Database

    from canest.road.table import RoadMap
    from canest.vehicle.effects import Effect

#: roles that the effect `torque_delay` finds late
TORQUE_ROLES = (
    "engine_torque_pct",
    "engine_torque_fraction",
    "engine_torque",
    "power",
    *AT_WHEELS,
    "half_shaft_torque_right",
    "engine_friction_pct",
    "retarder_torque_pct",
)
#: an accuracy of the config is two standard deviations in percent, one of the facts a fraction
TWO_STD_PCT = 200.0
_ACCELEROMETER = "longitudinal_accel"


class IntakeSpec(NamedTuple):
    """What selects, orders and checks frames.

    wants: role -> DBC signal. hold_us: silence after which ticks stop. max_backward_us: how far a
    stamp may go back. limits: range and rate per role. motion: roles whose jumps make the motion uncertain.
    torque: what torque roles may read.
    """

    wants: Mapping[str, Want]
    databases: list[Database]
    hold_us: int
    max_backward_us: int
    limits: Mapping[str, Limit]
    motion: frozenset[str]
    torque: Mapping[str, TorqueLimit]


class GridSpec(NamedTuple):
    """What holds samples on the 50 Hz ticks: one channel per role, and when ticks stop."""

    channels: tuple[Channel, ...]
    hold_us: int


class EstimatorSpec(NamedTuple):
    """Which estimator, what it may know of the vehicle, and its options; `where` locates its mistakes."""

    name: str
    facts: VehicleFacts
    options: Mapping[str, Any]

    def create(self) -> Estimator:
        """Return a fresh estimator. Errors: ConfigError."""
        return create(self.name, self.facts, self.options)


class PipelineSpec(NamedTuple):
    """All that a pipeline is made of."""

    intake: IntakeSpec
    grid: GridSpec
    model: ModelSpec
    assumed: AssumedConstants
    estimator: EstimatorSpec
    road: RoadMap | None = None


def build(config: Config) -> PipelineSpec:
    """Translate a config. Errors: ConfigError that names file, line and key."""
    spec = PipelineSpec(
        intake_spec(config),
        grid_spec(config),
        model_spec(config),
        assumed_constants(config),
        estimator_spec(config),
        config.road,
    )
    with located(config):
        spec.estimator.create()
    return spec


@contextmanager
def located(config: Config) -> Iterator[None]:
    """Name file and line in the config of a ConfigError that names only its key."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(
            error.what, where=config.at(error.where), found=error.found, expected=error.expected
        ) from error


def intake_spec(config: Config) -> IntakeSpec:
    """Return what decodes and checks the samples of a config."""
    roles, vehicle = tuple(config.signals), config.vehicle
    wants = wants_of(config)  # names every role that has no signal; what follows would name the first
    steps = {role: step_of(config, role) or 0.0 for role in LIMITED if role in roles}
    return IntakeSpec(
        wants=wants,
        databases=config.databases,
        hold_us=hold_us(config),
        max_backward_us=round(config.sampling.max_backward_s * 1e6),
        limits=limits_of(roles, vehicle.mps_per_shaft_rpm),
        motion=frozenset(motion_roles(roles, vehicle)),
        torque=torque_limits(roles, vehicle, _column_scales(config), steps),
    )


def grid_spec(config: Config) -> GridSpec:
    """Return the grid of a config: the signal map with its delays and staleness limits."""
    late_s = sum(float(getattr(e, "delay_s", 0.0)) for e in effects_of(config) if e.stage == "sampling")
    channels, has_steps = [], bool(config.vehicle.gear_ratios)
    for role, source in config.signals.items():
        stale_us = round(min(stale_limit_s(role, source) * 1e6, FOREVER_US))
        delay_s = source.delay_s + (late_s if role in TORQUE_ROLES else 0.0)
        channels.append(
            Channel(
                role,
                round(delay_s * 1e6),
                stale_us,
                between_of(role, source, has_steps=has_steps),
                wait_us(source),
            )
        )
    channels += [Channel(name, 0, round(JUMP_HOLD_S * 1e6)) for name in (JUMP, MOTION_JUMP)]
    return GridSpec(tuple(channels), hold_us(config))


def model_spec(config: Config) -> ModelSpec:
    """Return the vehicle model of a config. Errors: ConfigError for a config without torque or speed."""
    roles, vehicle = tuple(config.signals), config.vehicle
    with located(config):
        speed_roles(roles, vehicle)
        ratio_ways(roles, vehicle, torque_role(roles, vehicle))
    return ModelSpec(
        vehicle=vehicle,
        roles=roles,
        gates=config.gates,
        required=frozenset(role for role, source in config.signals.items() if not source.optional),
        effects=effects_of(config),
        filter=FilterSpec(config.filter.order, config.filter.cutoff_hz),
        friction_step_pct=step_of(config, "engine_friction_pct"),
        accelerometer=_accelerometer(config),
    )


def estimator_spec(config: Config) -> EstimatorSpec:
    """Return the estimator of a config."""
    return EstimatorSpec(config.estimator.name, facts_of(config), config.estimator.options)


def assumed_constants(config: Config) -> AssumedConstants:
    """Return the engine constants that the config assumes until the bus reports them."""
    roles = tuple(config.signals) if "engine_torque_pct" in config.signals else ()
    return AssumedConstants.of(roles, config.vehicle.reference_torque_Nm, config.vehicle.friction_torque_pct)


def facts_of(config: Config) -> VehicleFacts:
    """Return what the estimator may know of the vehicle."""
    v, roles = config.vehicle, tuple(config.signals)
    resolution, waits_s = resolution_of(config), behind_s(config)
    torque, speed = torque_role(roles, v), speed_in_use(roles, v)
    sensor, effects = config.signals.get(_ACCELEROMETER), {entry.get("effect") for entry in config.effects}
    slow = (config.signals[role].period_s for role in (torque, speed) if role in config.signals)
    geared, at_wheels = not v.has_one_gear or "gear_ratio" in roles, is_at_wheels(torque, roles)
    accessories = geared and not at_wheels  # and a gearbox, of an engine
    return VehicleFacts(
        mass_min_kg=v.mass_min_kg,
        mass_max_kg=v.mass_max_kg,
        initial_mass_kg=config.estimator.initial_mass_kg,
        initial_grade=config.estimator.initial_grade,
        rolling_resistance=v.rolling_resistance,
        pitch_rad_per_mps2=v.accelerometer.pitch_rad_per_mps2,
        speed_step_mps=resolution["speed"],
        torque_step_Nm=resolution["torque"],
        accelerometer_step_mps2=resolution["accelerometer"],
        has_accelerometer=sensor is not None and (sensor.period_s or 0.0) <= SLOWEST_ACCELEROMETER_S,
        has_road_map=config.road_map is not None,
        filter_delay_s=delay_s(butterworth(config.filter.order, config.filter.cutoff_hz)) + waits_s,
        waits_s=waits_s,
        report_period_s=max((period or 0.0 for period in slow), default=0.0),
        torque_accuracy=v.torque_accuracy_pct / TWO_STD_PCT,
        unreported_torque_Nm=0.0 if "torque_offset" in effects else 0.5 * v.lacking_torque_Nm(accessories),
        wheel_radius_accuracy=v.wheel_radius_accuracy_pct / TWO_STD_PCT,
        rolling_resistance_accuracy=v.rolling_resistance_accuracy_pct / TWO_STD_PCT,
        drag_area_accuracy=v.drag_area_accuracy_pct / TWO_STD_PCT,
        slips=speed in DRIVEN_SPEEDS and "wheel_slip" not in effects,
        torque_lags=geared,
        knows_retarder=at_wheels or v.retarder is not None,
        valid_std=config.estimator.valid_std_pct / 100.0,
    )


def effects_of(config: Config) -> tuple[Effect, ...]:
    """Return a config's effects, built."""
    if not config.effects:
        return ()
    from canest.vehicle.effects import effect_from_config  # all effects cost 30 ms, and few configs have one

    return tuple(effect_from_config(e, f"effects[{i}]") for i, e in enumerate(config.effects))


def behind_s(config: Config) -> float:
    """Return how long ago it is what the ticks show, for late and slow signals to be joined, s."""
    return behind_us(grid_spec(config).channels) * 1e-6


def _column_scales(config: Config) -> dict[str, tuple[float, float]]:
    """Return role -> what a number of its table column is multiplied by, and what is added then."""
    return {
        role: factor_and_offset(role, source, unit_of(source))
        for role, source in config.signals.items()
        if source.column is not None and role in ROLES and conversion(role, unit_of(source)) is not None
    }


def _accelerometer(config: Config) -> AccelerometerSource | None:
    own = config.signals.get(_ACCELEROMETER)
    if own is None:
        return None
    mates = tuple(
        role
        for role, source in config.signals.items()
        if role == _ACCELEROMETER
        or (own.message is not None and (own.message, own.source) == (source.message, source.source))
    )
    return AccelerometerSource(stale_limit_s(_ACCELEROMETER, own), mates)
