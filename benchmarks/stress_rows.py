"""The rows of the stress benchmark: what is driven, what is done to frames and samples, what is judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from stress_drives import (
    HEAVY_KG,
    LIGHT_KG,
    MANOEUVRE_S,
    MIXED,
    NIGHT_S,
    PHASES,
    PULSES,
    STATED_6_PCT,
    Scenario,
    after_a_night,
    behind_a_gateway,
    changed_by_a_third,
    changed_in_motion,
    changed_in_short_stop,
    cruise,
    looking_ahead,
    motorway,
    one_manoeuvre,
    other_vehicle,
    reported_late,
    rough_road,
    sine_road,
    slipstreams,
    spreader,
    stepped_road,
    town,
    truck,
    with_effects,
)

from canest.core.frames import FrameBlock
from canest.core.samples import ModelBlock

LOADS, FAULTS, ROADS, PRIORS, VEHICLES = (
    "Loads that change",
    "Signals that are wrong",
    "Roads and drivers",
    "Vehicles outside the priors",
    "Other vehicles and signals",
)
#: EEC1 of the engine, whose third byte is its torque in percent with an offset of 125
EEC1_ID, EEC1_ID_BITS = 0x0CF00400, 0x1FFFFFFF
TORQUE_SHIFT, ZERO_TORQUE = np.uint64(16), np.uint64(125)
TORQUE_BYTE = np.uint64(0xFF) << TORQUE_SHIFT
STUCK_MPS2 = 0.3


@dataclass(frozen=True)
class Row:
    """Drives of one kind.

    drive: a seed -> one scenario, or several one after the other. edit_frames, edit_samples: what is wrong
    with the signals. facts: what the vehicle's facts say otherwise. judged_s: the part of the drive that
    counts, seconds from its first sample on. phases: so many drives per seed. start_kg: the mass that the
    estimators are told. own_config: see `prepare`.
    """

    name: str
    group: str
    drive: Callable[[int], Scenario | tuple[Scenario, ...]]
    edit_frames: Callable[[FrameBlock], FrameBlock] | None = None
    edit_samples: Callable[[ModelBlock], ModelBlock] | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    judged_s: tuple[float, float] | None = None
    accelerometer: tuple[bool, ...] = (False, True)
    phases: int = 1
    start_kg: float = 21000.0
    own_config: bool = False

    def scenarios(self, seed: int) -> tuple[Scenario, ...]:
        """Return what is driven one after the other."""
        found = self.drive(seed)
        return found if isinstance(found, tuple) else (found,)


def torque_zeros(share: float, frames: FrameBlock) -> FrameBlock:
    """Return the frames with this share of the engine's torque samples at 0 %, one at a time."""
    rng = np.random.default_rng(len(frames))
    hit = ((frames.can_id & EEC1_ID_BITS) == EEC1_ID) & (rng.random(len(frames)) < share)
    zero = (frames.data & ~TORQUE_BYTE) | (ZERO_TORQUE << TORQUE_SHIFT)
    return replace(frames, data=np.where(hit, zero, frames.data))


def inverted(samples: ModelBlock) -> ModelBlock:
    """Return the samples with an accelerometer that is mounted the other way round."""
    return replace(samples, accelerometer_mps2=-samples.accelerometer_mps2)


def with_gain(samples: ModelBlock, gain: float) -> ModelBlock:
    """Return samples whose accelerometer shows so many times what it should."""
    return replace(samples, accelerometer_mps2=gain * samples.accelerometer_mps2)


def stuck(samples: ModelBlock) -> ModelBlock:
    """Return the samples with an accelerometer that always sends one number."""
    return replace(samples, accelerometer_mps2=np.full(len(samples), STUCK_MPS2))


def _both_ways(seed: int, size: float) -> float:
    return size if seed % 2 else -size


def _torque_off(seed: int) -> Scenario:
    gain = {"effect": "torque_gain", "gain": 1 + _both_ways(seed, 0.06)}
    return with_effects(seed, gain, small_errors=False)


def _windy(seed: int) -> Scenario:
    return with_effects(seed, {"effect": "headwind", "wind_mps": _both_ways(seed, 8.0)})


_MORE_ROLLING = {"effect": "rolling_resistance", "crr_delta": 0.4 * 0.006}
_LARGE = (
    {"effect": "torque_offset", "torque_Nm": 30.0},
    {"effect": "drag_area", "cda_delta_m2": 1.0},
    {"effect": "brake_drag", "force_N": 400.0},
    {"effect": "drafting", "reduction": 0.4},
)
_UNREPORTED = {"effect": "retarder_unreported", "torque_Nm": 250.0}
_CHANGES = cruise(21.0, 18.0, change_mps=3.0, change_every_s=50.0)

ROWS = (
    *(
        Row(f"spreader {rate} kg/s, {name}", LOADS, partial(spreader, rate_kgps=rate, driver=driver))
        for rate in (10, 14)
        for name, driver in (("mixed", MIXED), ("pulses", PULSES), ("town", town()))
    ),
    Row("loaded in motion", LOADS, partial(changed_in_motion, before=LIGHT_KG, after=HEAVY_KG)),
    Row("unloaded in motion", LOADS, partial(changed_in_motion, before=HEAVY_KG, after=LIGHT_KG)),
    Row("a third more or less in motion", LOADS, changed_by_a_third),
    Row("other load after 12 to 22 s", LOADS, changed_in_short_stop),
    Row("first 10 s after eight hours", LOADS, after_a_night, judged_s=(NIGHT_S, NIGHT_S + 310.0)),
    *(
        Row(f"torque zeros {percent} %", FAULTS, truck, edit_frames=partial(torque_zeros, percent / 100))
        for percent in (2, 5, 10)
    ),
    Row("torque reported 0.4 s late, pulses", FAULTS, reported_late),
    Row("retarder unreported", FAULTS, lambda seed: with_effects(seed, _UNREPORTED)),
    Row("accelerometer inverted", FAULTS, truck, edit_samples=inverted, accelerometer=(True,)),
    Row("accelerometer stuck", FAULTS, truck, edit_samples=stuck, accelerometer=(True,)),
    *(
        Row(
            f"accelerometer shows {gain:g} times",
            FAULTS,
            truck,
            edit_samples=partial(with_gain, gain=gain),
            accelerometer=(True,),
        )
        for gain in (0.7, 0.85, 1.15, 1.3)
    ),
    Row("road in steps", ROADS, stepped_road),
    Row("sine road, cruise", ROADS, partial(sine_road, wavelength_m=800.0, driver=cruise(22.0, 21.0))),
    Row("sine road, mixed", ROADS, partial(sine_road, wavelength_m=600.0, driver=MIXED)),
    Row("short waves, mixed", ROADS, partial(sine_road, wavelength_m=200.0, driver=MIXED)),
    Row("motorway", ROADS, motorway),
    Row("slipstreams, cruise", ROADS, partial(slipstreams, driver=cruise(23.5, 20.0))),
    Row("slipstreams, mixed", ROADS, partial(slipstreams, driver=MIXED)),
    Row("cruise, speed changes", ROADS, lambda seed: truck(seed, driver=_CHANGES)),
    Row("rough road", ROADS, rough_road),
    Row("driver looks ahead", ROADS, looking_ahead),
    Row("one manoeuvre of 168 m", ROADS, one_manoeuvre, judged_s=(MANOEUVRE_S, 1000.0), phases=PHASES),
    Row("wind 8 m/s", PRIORS, _windy),
    Row("rolling resistance +40 %", PRIORS, lambda seed: with_effects(seed, _MORE_ROLLING)),
    Row("torque 6 % off, stated", PRIORS, _torque_off, facts=STATED_6_PCT),
    Row("several large errors", PRIORS, lambda seed: with_effects(seed, *_LARGE)),
    Row("light truck", VEHICLES, partial(other_vehicle, "light-truck"), start_kg=6000.0, own_config=True),
    Row("car", VEHICLES, partial(other_vehicle, "car"), start_kg=2000.0, own_config=True),
    Row("electric car", VEHICLES, partial(other_vehicle, "electric-car"), start_kg=2000.0, own_config=True),
    Row("signals by a J1587 gateway", VEHICLES, behind_a_gateway, own_config=True),
    Row("pitch not stated", VEHICLES, truck, facts={"pitch_rad_per_mps2": None}),
)
BY_NAME = {row.name: row for row in ROWS}
