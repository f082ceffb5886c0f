"""Drivers: what speed or what pedal is wanted when, and how it may be reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from canest.core.frames import FloatColumn
from canest.simulation.constants import PLAN_S
from canest.simulation.vehicles import Increasing, Range, Stretch, Strict, same_length

# All chosen.
FIRST_START_S = (2.0, 5.0)  #: a stop-and-go driver starts between the two
BEFORE_LONG_STOP_S = 15.0  #: shortest drive before a long stop
FULL_SPEED_S = 10.0  #: a drive with less time before braking ...
SHORT_DRIVE = 0.6  #: ... is made at this share of its speed
NO_THROTTLE = -1.0  #: in a plan


class _Driver(Strict):
    start_mps: float = Field(0.0, ge=0)
    fixed_gear: int | None = Field(None, ge=1)
    brakes: bool = True  #: may brake when the wanted speed asks for it
    firmness_1ps: float = Field(0.5, gt=0, le=2)  #: acceleration wanted per m/s of speed error
    retarder: bool = False  #: uses the (reported) engine brake before the brakes


class Cruise(_Driver):
    """Holds a speed; optionally another one now and then."""

    kind: Literal["cruise"]
    firmness_1ps: float = Field(0.1, gt=0, le=2)
    speed_mps: float = Field(gt=0)
    change_mps: float = Field(0.0, ge=0)
    change_every_s: float = Field(60.0, gt=0)


class Pulses(_Driver):
    """Throttle on and off between two speeds (2005 paper, Figure 8)."""

    kind: Literal["pulses"]
    on_s: Stretch = (5.0, 9.0)
    off_s: Range = (3.0, 6.0)
    throttle: Range = (0.9, 1.0)
    max_mps: float = Field(24.0, gt=0)
    min_mps: float = Field(12.0, ge=0)
    brakes: bool = False


class Mixed(_Driver):
    """Ordinary driving: speed targets that change with the traffic, sometimes a firm throttle."""

    kind: Literal["mixed"]
    firmness_1ps: float = Field(0.25, gt=0, le=2)
    speeds_mps: Range = (10.0, 24.0)
    hold_s: Stretch = (15.0, 45.0)


class StopAndGo(_Driver):
    """Launch, drive, brake to a stop, stand; launches only when `speed_mps` holds one speed."""

    kind: Literal["stop-and-go"]
    speeds_mps: Range = (9.0, 16.0)
    drive_s: Stretch = (40.0, 90.0)
    stand_s: Range = (8.0, 20.0)
    long_stops: tuple[tuple[float, float], ...] = ()  #: (from t_s, for s): stands there, for loading
    braking_mps2: float = Field(0.9, gt=0)


class Given(_Driver):
    """Wanted speed by time, linear between points; `throttle` (0..1, null: none) overrides it."""

    kind: Literal["given"]
    at_s: Increasing
    speed_mps: list[float]
    throttle: list[float | None] | None = None

    @model_validator(mode="after")
    def _one_each(self) -> Given:
        same_length(self.at_s, speed_mps=self.speed_mps, throttle=self.throttle)
        return self


Driver = Annotated[Cruise | Pulses | Mixed | StopAndGo | Given, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True)
class Plan:
    """Every `PLAN_S`: wanted speed (m/s), and the throttle (0..1) that overrides it, negative for none."""

    target_mps: FloatColumn
    throttle: FloatColumn


def plan(driver: Driver, duration_s: float, rng: np.random.Generator) -> Plan:
    """Draw up what a driver wants over a whole drive."""
    t = np.arange(0.0, duration_s + 2 * PLAN_S, PLAN_S)
    throttle = np.full_like(t, NO_THROTTLE)
    target = np.zeros_like(t)
    match driver:
        case Cruise():
            target[:] = driver.speed_mps
            if driver.change_mps:
                for start in np.arange(driver.change_every_s, t[-1], driver.change_every_s):
                    target[t >= start] = driver.speed_mps + rng.uniform(-1, 1) * driver.change_mps
        case Pulses():
            now = 0.0
            target[:] = driver.max_mps
            while now < t[-1]:
                on, off = rng.uniform(*driver.on_s), rng.uniform(*driver.off_s)
                throttle[(t >= now) & (t < now + on)] = rng.uniform(*driver.throttle)
                throttle[(t >= now + on) & (t < now + on + off)] = 0.0
                now += on + off
        case Mixed():
            now = 0.0
            while now < t[-1]:
                hold = rng.uniform(*driver.hold_s)
                target[(t >= now) & (t < now + hold)] = rng.uniform(*driver.speeds_mps)
                now += hold
        case StopAndGo():
            target = _stop_and_go(driver, t, rng)
        case Given():
            target = np.interp(t, driver.at_s, driver.speed_mps)
            if driver.throttle is not None:
                index = np.clip(np.searchsorted(driver.at_s, t, "right") - 1, 0, len(driver.at_s) - 1)
                steps = np.array([NO_THROTTLE if value is None else value for value in driver.throttle])
                throttle = steps[index]
    return Plan(target, throttle)


def _stop_and_go(driver: StopAndGo, t: FloatColumn, rng: np.random.Generator) -> FloatColumn:
    target = np.zeros_like(t)
    now = rng.uniform(*FIRST_START_S)
    long_stops = sorted(driver.long_stops)
    while now < t[-1]:
        speed, drive, stand = (rng.uniform(*r) for r in (driver.speeds_mps, driver.drive_s, driver.stand_s))
        stop = now + drive
        if long_stops and stop + stand > long_stops[0][0]:
            at, stand = long_stops.pop(0)
            stop = max(at, now + BEFORE_LONG_STOP_S)
        slowing = stop - speed / driver.braking_mps2
        going = (t >= now) & (t < stop)
        target[going] = np.minimum(speed, np.maximum(0.0, (stop - t[going]) * driver.braking_mps2))
        if slowing < now + FULL_SPEED_S:
            target[going] = np.minimum(target[going], speed * SHORT_DRIVE)
        now = stop + stand
    return target
