"""Model samples from a small truck of our own: loads, delays, slip, stops, an accelerometer, altitudes.

Independent of the pipeline and of `canest.simulation`; signals are not filtered, so the relation is exact but
for what is asked for here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S, STEP_US, ModelBlock, VehicleFacts

MU = 0.006
ROTATING_KG = 700.0
WHEELS_KG = 500.0
GEAR_1PM = 7.3
FACTS = VehicleFacts(mass_min_kg=7_000.0, mass_max_kg=40_000.0, pitch_rad_per_mps2=0.01)


@dataclass
class Trip:
    block: ModelBlock
    mass_kg: np.ndarray
    grade: np.ndarray

    def error(self, estimates):
        return estimates.mass_kg / self.mass_kg - 1.0


def hills(s):
    return 0.025 * np.sin(s / 400.0) + 0.01 * np.sin(s / 150.0 + 1.0)


def flat(s):
    return 0.0 * s


def pulses(t, v):
    """Throttle between overrun and 85 %, in ramps of half a second."""
    return float(np.clip(0.45 + 1.2 * np.sin(t / 2.2) + 0.3 * np.sin(t / 5.1), -0.03, 0.85))


def steady(t, v):
    """Cruise control at 24 m/s."""
    return float(np.clip(0.27 + 0.15 * (24.0 - v), -0.03, 0.85))


def trip(
    seconds: float,
    *,
    mass_kg: float | list[tuple[float, float]] = 21_000.0,
    road: Callable = hills,
    throttle: Callable = pulses,
    stops: list[tuple[float, float]] | None = None,
    shifts: list[tuple[float, float]] | None = None,
    delay_s: float = 0.06,
    lag_s: float = 0.0,
    slip_per_mps2: float = 0.0,
    windup_mpN: float = 0.0,
    gain: float = 1.0,
    accelerometer: bool = False,
    bias_mps2: float = 0.1,
    pitch_rad_per_mps2: float = 0.01,
    sensed_noise_mps2: float = 0.04,
    altitude: bool = False,
    unreported: tuple[float, float, float] = (0.0, 0.0, 0.0),
    unseen_N: Callable = flat,
    noise: float = 1.0,
    start_mps: float = 20.0,
    seed: int = 1,
) -> Trip:
    """Drive; ``stops`` are (start, end) in seconds, ``mass_kg`` one load or (from second, load) pairs.

    In ``shifts`` the driveline is open, and the gates stay closed for 0.6 s more. ``unreported``
    is a retarder that nobody reports: from, until (s) and its force (N). ``unseen_N``: any other force
    against the motion, by time. ``lag_s``: time constant with which the force follows the report.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    t = np.arange(n) * STEP_S
    loads = [(0.0, mass_kg)] if isinstance(mass_kg, (int, float)) else mass_kg
    mass = np.zeros(n)
    for since, load in loads:
        mass[t >= since] = load
    v, a, s, traction, aero = start_mps, np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    speed, gate, x, parted = np.zeros(n), np.zeros(n, np.uint8), 0.0, np.zeros(n, np.bool_)
    pull, acts, asked = 0.0, 0.0, np.zeros(n)
    for i in range(n):
        standing = any(b <= t[i] < e for b, e in stops or [])
        braking = any(b - 15.0 <= t[i] < b for b, e in stops or [])
        wanted = 0.0 if braking or standing else throttle(t[i], v) * (2.2 if v < 12.0 else 1.0) * 11_000.0
        pull += (wanted - pull) * STEP_S / 0.3
        is_parted = any(b <= t[i] < e for b, e in shifts or [])
        if is_parted:
            pull = acts = 0.0
            gate[i], parted[i] = Gate.SHIFT, True
        elif any(e <= t[i] < e + 0.6 for b, e in shifts or []):
            gate[i] = Gate.RECOVERY
        aero[i] = 3.8 * v * v
        slope = float(np.sin(np.arctan(road(np.array(x)))))
        acts += (pull - acts) * (1.0 if lag_s == 0.0 else 1.0 - np.exp(-STEP_S / lag_s))
        traction[i], asked[i] = acts, pull
        road_force = mass[i] * GRAVITY_MPS2 * (slope + MU)
        unseen = unseen_N(t[i]) + (unreported[2] if unreported[0] <= t[i] < unreported[1] else 0.0)
        a[i] = (acts - unseen - aero[i] - road_force) / (mass[i] + (WHEELS_KG if is_parted else ROTATING_KG))
        if braking:
            a[i], gate[i] = -min(2.0, v / STEP_S), Gate.BRAKE
        if standing:
            a[i], gate[i] = -v / STEP_S, Gate.LOW_SPEED
        v = max(v + a[i] * STEP_S, 0.0)
        x += v * STEP_S
        speed[i], s[i] = v, x
        if v < 2.0 and gate[i] == 0:
            gate[i] = Gate.LOW_SPEED
    late = round(delay_s / STEP_S)
    reported = np.concatenate((np.full(late, asked[0]), asked[: n - late])) / gain
    measured = speed * (1.0 + slip_per_mps2 * traction / mass) + noise * rng.normal(0, 0.002, n)
    measured += windup_mpN * np.gradient(traction, STEP_S)  # what the driveline gives way
    accel = np.diff(measured, prepend=measured[0]) / STEP_S
    grade = road(s)
    nan = np.full(n, np.nan)
    sensed = a + GRAVITY_MPS2 * (np.sin(np.arctan(grade)) + pitch_rad_per_mps2 * a) + bias_mps2
    heights = 100.0 + np.cumsum(np.sin(np.arctan(grade)) * speed) * STEP_S + rng.normal(0, 1.0, n)
    held = np.round(heights[(np.arange(n) // 50) * 50] / 0.125) * 0.125
    block = ModelBlock(
        t_us=np.arange(n) * STEP_US,
        speed_mps=measured,
        accel_mps2=accel,
        force_N=reported - aero - ROTATING_KG * accel,
        mu=np.full(n, MU),
        traction_N=reported,
        aero_N=aero,
        force_per_torque_1pm=np.full(n, GEAR_1PM),
        rotating_mass_kg=np.where(parted, WHEELS_KG, ROTATING_KG),
        coasting_N=np.where(parted, -aero, nan),
        undriven_mps=speed + noise * rng.normal(0, 0.003, n) if slip_per_mps2 else nan,
        accelerometer_mps2=sensed + noise * rng.normal(0, sensed_noise_mps2, n) if accelerometer else nan,
        slope=nan,
        altitude_m=held if altitude else nan,
        yaw_rate_radps=nan,
        raw_speed_mps=measured,
        raw_force_N=reported - aero - ROTATING_KG * accel,
        raw_torque_Nm=reported / GEAR_1PM,
        gear=np.zeros(n),
        gate=gate,
        restart=np.concatenate(([True], (gate[1:] == 0) & (gate[:-1] != 0))),
        stopped=speed < 0.05,
        ax_ok=np.full(n, accelerometer),
    )
    return Trip(block, mass, grade)
