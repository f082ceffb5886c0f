"""Runs a scenario: truth first, then what the bus shows of it."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from canest.core import jit
from canest.core.errors import ConfigError, UsageError
from canest.core.frames import FloatColumn
from canest.simulation.build import course_of, initial_state, vehicle_parameters
from canest.simulation.bus_car import car_frames
from canest.simulation.bus_j1939 import j1939_frames, with_positions
from canest.simulation.constants import BRAKE_LIGHT, COLUMN_COUNT, RECORD_S, RECORDS_PER_PLAN_STEP
from canest.simulation.data_sheet import known_config
from canest.simulation.drive import SimulatedDrive
from canest.simulation.effects import Hidden, combine, small_errors
from canest.simulation.motion import move, plan_at, step
from canest.simulation.parameters import Course, VehicleParameters
from canest.simulation.reading import load_scenario, name_of
from canest.simulation.scenario import Scenario
from canest.simulation.sensors import Signals

TRUTH_HZ = 10
#: random streams, each its own: another road or another effect leaves the other draws as they were
_STREAMS = ("road", "driver", "errors", "sensors", "bus", "drafting", "positions")
MOVED = 0.6  #: share of the time that the motion takes, for progress


def simulate(
    scenario: Scenario | dict[str, Any] | str | Path,
    seed: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> SimulatedDrive:
    """Simulate a scenario (given, a mapping, a file, or a shipped name), with its own seed or another.

    The same seed gives the same frames to the last bit. `progress` is called with 0..1.
    Errors: ConfigError.
    """
    name = name_of(scenario) if isinstance(scenario, str | Path) else "drive"
    spec = load_scenario(scenario)
    report = progress or (lambda share: None)
    report(0.0)
    rng = _streams(spec.seed if seed is None else seed)
    effects, damping = _undeclared(spec, rng["errors"])
    hidden = combine(effects, len(spec.vehicle.gear_ratios), damping)
    records = _moved(spec, hidden, rng)
    report(MOVED)
    signals = Signals(records, spec, hidden, rng["sensors"])
    frames_of = car_frames if spec.vehicle.layout == "car" else j1939_frames
    frames = frames_of(signals, spec, hidden.load, rng["bus"])
    if spec.positions is not None:
        frames = with_positions(frames, signals, spec, rng["positions"])
    report(1.0)
    return SimulatedDrive(
        name=name,
        frames=frames,
        truth=_truth(signals, spec),
        config=known_config(spec),
        undeclared=[effect.model_dump() for effect in effects],
        history={**signals.table, "t_s": signals.t_s},
    )


def simulate_to_directory(
    scenario: str | Path,
    out_dir: str | Path,
    progress: Callable[[float], None] | None = None,
    *,
    seed: int | None = None,
    compress: bool = False,
    force: bool = False,
) -> list[Path]:
    """Simulate a scenario file or shipped name and write its log, truth and config; return their paths.

    compress, force: see `SimulatedDrive.write`. Errors: ConfigError, OutputError, UsageError.
    """
    return simulate(scenario, seed, progress).write(out_dir, compress=compress, force=force)


def _streams(seed: int) -> dict[str, np.random.Generator]:
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise UsageError("no seed", where="seed", found=seed, expected="a whole number of 0 or more")
    children = np.random.SeedSequence(seed).spawn(len(_STREAMS))
    return {stream: np.random.default_rng(child) for stream, child in zip(_STREAMS, children, strict=True)}


def _undeclared(spec: Scenario, rng: np.random.Generator) -> tuple[list[Any], float | None]:
    """Return the undeclared effects and, with small errors, the driveline's damping ratio."""
    drawn, damping = small_errors(spec.vehicle.crr, rng)
    if not spec.small_errors:
        return list(spec.undeclared), None
    return [*spec.undeclared, *drawn], damping


def _moved(spec: Scenario, hidden: Hidden, rng: dict[str, np.random.Generator]) -> FloatColumn:
    """Return the records of the motion, flat. Errors: ConfigError."""
    # interpreted, a list is indexed three times faster than an array
    contain: Any = np.asarray if jit.enabled() else np.ndarray.tolist
    course = course_of(spec, hidden, rng, contain)
    vehicle = vehicle_parameters(spec, hidden, contain)
    state = initial_state(spec, vehicle, float(course.masses[0]), contain)
    records = round(spec.duration_s / RECORD_S)
    if jit.enabled():
        out = np.zeros(records * COLUMN_COUNT)
        move(vehicle, course, state, out)
    else:
        out = _interpreted(vehicle, course, list(state), records)
    if not np.isfinite(out).all():
        raise ConfigError("the motion became unstable", where="vehicle", expected="plausible constants")
    return out


def _interpreted(vehicle: VehicleParameters, course: Course, state: list[float], records: int) -> FloatColumn:
    """Return what `move` gives: the interpreter adds a whole row faster than it sets twenty numbers."""
    rows, take_step = array("d"), step.interpreted
    for k in range(records):
        if k % RECORDS_PER_PLAN_STEP == 0:
            plan = plan_at.interpreted(course, k // RECORDS_PER_PLAN_STEP)
        take_step(vehicle, course, plan, state, k * RECORD_S)
        rows.fromlist(state[:COLUMN_COUNT])
    return np.frombuffer(rows)


def _truth(signals: Signals, spec: Scenario) -> dict[str, FloatColumn]:
    t = np.arange(0, math.floor(spec.duration_s * TRUTH_HZ)) / TRUTH_HZ
    linear = ("distance_m", "speed_mps", "accel_mps2", "grade")
    return {
        "t_s": t + spec.bus.start_s,
        **{name: signals.at(name, t) for name in linear},
        "mass_kg": signals.held("mass_kg", t),
        "elevation_m": signals.at("elevation_m", t),
        "shift": signals.shifting(t).astype(np.float64),
        "brake": (signals.held("brake", t) > BRAKE_LIGHT).astype(np.float64),
    }
