"""Runs a scenario: truth first, then what the bus shows of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from canest.core import jit
from canest.core.errors import ConfigError, OutputError
from canest.core.frames import FloatColumn, FrameBlock
from canest.simulate.bus_j1939 import j1939_frames
from canest.simulate.constants import COLUMNS, RECORD_S, TORQUE_TABLE_RPM, true_constants
from canest.simulate.drivers import PLAN_S, plan
from canest.simulate.effects import Hidden, combine, small_errors
from canest.simulate.known import known_config
from canest.simulate.motion import move
from canest.simulate.reading import load_scenario, name_of
from canest.simulate.roads import lay
from canest.simulate.scenario import Scenario
from canest.simulate.signals import Signals

TRUTH_HZ = 10
#: random streams, each its own: another road or another effect leaves the other draws as they were
_STREAMS = ("road", "driver", "errors", "sensors", "bus", "drafting")
FASTEST_MPS = 45.0  #: sets how much road is laid


@dataclass(frozen=True)
class SimulatedDrive:
    """A drive with its truth.

    frames: what was on the bus. truth: columns at 10 Hz (t_s, distance_m, speed_mps, accel_mps2, grade,
    mass_kg, elevation_m, shift, brake), (n,) each. config: what an engineer would know.
    undeclared: the effects in force that the config does not know, small errors included. history: every
    column of `constants.COLUMNS` at 200 Hz, for tests.
    """

    name: str
    frames: FrameBlock
    truth: dict[str, FloatColumn]
    config: dict[str, Any]
    undeclared: list[dict[str, Any]]
    history: dict[str, FloatColumn]

    def write(self, directory: str | Path, *, compress: bool = False) -> list[Path]:
        """Write NAME.log (or NAME.log.xz), NAME.truth.csv and NAME.yaml; return their paths.

        Errors: OutputError when the directory cannot be written.
        """
        from canest.simulate.files import write_drive

        try:
            return write_drive(self, Path(directory), compress)
        except OSError as error:
            raise OutputError(f"cannot be written ({error.strerror})", where=str(directory)) from error


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
    tell = progress or (lambda share: None)
    tell(0.0)
    root = np.random.SeedSequence(spec.seed if seed is None else seed)
    rng = {
        stream: np.random.default_rng(child)
        for stream, child in zip(_STREAMS, root.spawn(len(_STREAMS)), strict=True)
    }
    effects = list(spec.undeclared)
    damping = None
    drawn, oscillating = small_errors(spec.vehicle.crr, rng["errors"])
    if spec.small_errors:
        effects += drawn
        damping = oscillating
    hidden = combine(effects, len(spec.vehicle.gear_ratios), damping)
    records = _drive(spec, hidden, rng)
    tell(0.6)
    signals = Signals(records, spec, hidden, rng["sensors"])
    if spec.vehicle.layout == "car":
        from canest.simulate.bus_car import car_frames as frames_of
    else:
        frames_of = j1939_frames
    frames = frames_of(signals, spec, hidden.load, spec.duration_s, rng["bus"])
    tell(1.0)
    return SimulatedDrive(
        name=name,
        frames=frames,
        truth=_truth(signals, spec),
        config=known_config(spec),
        undeclared=[effect.model_dump() for effect in effects],
        history={**signals.table, "t_s": signals.t_s},
    )


def _drive(spec: Scenario, hidden: Hidden, rng: dict[str, np.random.Generator]) -> FloatColumn:
    vehicle, driver = spec.vehicle, spec.driver
    ratios = [ratio * vehicle.final_drive for ratio in vehicle.gear_ratios]
    intent = plan(driver, spec.duration_s, rng["driver"])
    road = lay(spec.road, spec.duration_s * FASTEST_MPS, rng["road"])
    t = np.arange(len(intent.target_mps)) * PLAN_S
    extra = np.full_like(t, hidden.crr_delta)
    for cold, tau in hidden.warmups:
        extra += cold * np.exp(-t / tau)
    drag_scale = np.ones_like(t)
    if hidden.drafting:
        now, behind = 0.0, False
        while now < t[-1]:
            until = now + rng["drafting"].uniform(0.4, 1.6) * hidden.drafting.period_s
            if behind:
                drag_scale[(t >= now) & (t < until)] = 1 - hidden.drafting.reduction
            now, behind = until, not behind
    load_on = np.zeros_like(t)
    if hidden.load:
        load_on = (np.mod(t, hidden.load.period_s) < hidden.load.on_s).astype(float)
    table_rpm = np.arange(0.0, vehicle.full_torque[-1][0] + 1000.0, TORQUE_TABLE_RPM)
    full = np.interp(table_rpm, *np.array(vehicle.full_torque).T)
    full[table_rpm > vehicle.full_torque[-1][0]] = 0.0

    changes = [(change.t_s, change.mass_kg) for change in spec.mass_kg]
    times = sorted({when for when, _ in changes} | {when for when, _ in hidden.payloads})
    masses = [
        next(kg for when, kg in reversed(changes) if when <= at)
        + sum(d for when, d in hidden.payloads if when <= at)
        for at in times
    ]
    if min(masses) <= 0:
        raise ConfigError("the mass must stay positive", where="mass_kg", found=f"{min(masses):g} kg")

    constants = true_constants(spec, hidden, ratios)
    count = round(spec.duration_s / RECORD_S)
    columns = [full, ratios, vehicle.gear_efficiencies, hidden.kept, road.grade, road.curvature_1pm,
               intent.target_mps, intent.throttle, extra, drag_scale, load_on, times, masses]  # fmt: skip
    arrays = [np.asarray(column, np.float64) for column in columns]
    out = np.zeros(count * len(COLUMNS))
    if jit.enabled():
        move(constants, *arrays, out)
    else:
        # a list is indexed three times faster than an array; the buffer is filled through a view
        move(constants, *[array.tolist() for array in arrays], memoryview(out.data))
    if not np.isfinite(out).all():
        raise ConfigError("the motion became unstable", where="vehicle", expected="plausible constants")
    return out


def _truth(signals: Signals, spec: Scenario) -> dict[str, FloatColumn]:
    t = np.arange(0, math.floor(spec.duration_s * TRUTH_HZ)) / TRUTH_HZ
    continuous = {
        name: signals.at(name, t)
        for name in ("distance_m", "speed_mps", "accel_mps2", "grade", "mass_kg", "elevation_m")
    }
    continuous["mass_kg"] = signals.held("mass_kg", t)
    return (
        {"t_s": t + spec.bus.start_s}
        | continuous
        | {
            "shift": signals.shifting(t).astype(np.float64),
            "brake": (signals.held("brake", t) > 0.003).astype(np.float64),
        }
    )


def simulate_to_directory(
    scenario: str | Path,
    out_dir: str | Path,
    progress: Callable[[float], None] | None = None,
    *,
    seed: int | None = None,
    compress: bool = False,
) -> list[Path]:
    """Simulate a scenario file or shipped name and write its log, truth and config; return their paths."""
    return simulate(scenario, seed, progress).write(out_dir, compress=compress)
