"""The Cramér-Rao bound of mass and grade along a drive whose true states are known.

It is written from the equations of motion and shares no code with the estimator, only the priors of road,
wind, delay, bias and torque that the report lacks. It knows more than an estimator can: how soft the
driveline is, and the pitch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from judging import Drive
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FloatColumn
from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S
from canest.estimators.default.coasting import EARLY, SETTLES
from canest.estimators.default.constants import CONSTANTS

#: loads, uniform in their logarithm
LOADS_KG = (9000.0, 36000.0)
#: how a road begins, a sine, and how much of one is laid, m
START_GRADE_STD, ROAD_M = 0.01, 12_000
#: noise and resolution of the shaft's speed, and the wheel's speed by it; resolution of the torque
SHAFT_NOISE_RPM, SHAFT_STEP_RPM, MPS_PER_RPM = 0.4, 0.125, 2.0 * math.pi / 60.0 / 3.73 * 0.5
TORQUE_STEP_NM = 21.0
SENSED_NOISE_MPS2, SENSED_STEP_MPS2 = 0.06, 0.1
SPEED_VAR = MPS_PER_RPM**2 * (SHAFT_NOISE_RPM**2 + SHAFT_STEP_RPM**2 / 12.0)
#: how the friction grows with the speed of the engine: 1.8 % of the reference torque per 1000 rpm
FRICTION_NM_PER_RADPS = 0.018 * 2100.0 / 1000.0 * 30.0 / math.pi
TORQUE_VAR = TORQUE_STEP_NM**2 / 12.0
#: std of the torque at the crank that the report lacks: half a step
OFFSET_STD_NM = 0.5 * TORQUE_STEP_NM
SENSED_VAR = SENSED_NOISE_MPS2**2 + SENSED_STEP_MPS2**2 / 12.0
#: variance of a speed that an unknown force has led to, (m/s)2, and before the first sample
UNKNOWN_V, START_V = 100.0, 100.0
#: states: speed, grade, its change per metre, inverse mass, rounding errors of indicated torque and of
#: friction, torque that the report lacks, delay of the torque, headwind, bias of the accelerometer
STATES = 10
V, GRADE, CURVATURE, U, TORQUE, FRICTION, OFFSET, DELAY, WIND, BIAS = range(STATES)
#: which state acts on the speed by which column of `Truth`
_ACTS = (
    (U, "by_u"), (TORQUE, "by_torque"), (FRICTION, "by_friction"), (OFFSET, "by_torque"), (DELAY, "by_delay"),
    (WIND, "by_wind"),
)  # fmt: skip
#: when a simulated drive begins
START_S = 1_700_000_000

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Road:
    """A road of the model's own process: metre by metre its sine and where it is curved."""

    sine: FloatColumn
    curved: BoolColumn


@dataclass(frozen=True)
class Truth:
    """What the equations need of a drive, sample by sample (n,).

    by_u, by_torque, by_friction, by_delay, by_wind: acceleration by a unit of the inverse mass, which is
    (F - J a) / (1 + u J), of indicated torque, of friction, of delay and of headwind. rotating: 1 + u J.
    keeps, keeps_friction: correlation of a torque's rounding error with that of the sample before.
    known: where the force is known. curved: where the road is.
    """

    mass_kg: float
    metres: FloatColumn
    by_u: FloatColumn
    by_torque: FloatColumn
    by_friction: FloatColumn
    by_delay: FloatColumn
    by_wind: FloatColumn
    rotating: FloatColumn
    keeps: FloatColumn
    keeps_friction: FloatColumn
    known: BoolColumn
    curved: BoolColumn


def draw_road(rng: np.random.Generator, steepest: float) -> Road:
    """Draw a road: straight or curved by turns, curvature an Ornstein-Uhlenbeck process, grade a walk.

    A stretch that would lead beyond the steepest grade is drawn again.
    """
    c = CONSTANTS
    left = math.exp(-1.0 / c.curvature_length_m)
    kick = c.curvature_std_1pm * math.sqrt(1.0 - left * left)
    sine, curved = np.empty(ROAD_M), np.zeros(ROAD_M, np.bool_)
    sine[0] = rng.normal(0.0, START_GRADE_STD)
    at, bends = 1, False
    while at < ROAD_M:
        length = min(
            1 + int(rng.exponential(c.curved_length_m if bends else c.straight_length_m)), ROAD_M - at
        )
        steps = rng.normal(0.0, math.sqrt(c.smooth_wander_1pm), length)
        if bends:
            curvature = rng.normal(0.0, c.curvature_std_1pm)
            for k in range(length):
                steps[k] += curvature
                curvature = left * curvature + kick * rng.normal()
        stretch = sine[at - 1] + np.cumsum(steps)
        if np.abs(stretch).max() > max(steepest, abs(sine[at - 1])):
            continue
        sine[at : at + length], curved[at : at + length] = stretch, bends
        at, bends = at + length, not bends
    return Road(sine, curved)


def at_rest(coasts: BoolColumn) -> BoolColumn:
    """Return where a driveline has been open for long enough to be at rest, and is not about to close."""
    rest = coasts.copy()
    for ticks in range(1, SETTLES + 1):
        rest[ticks:] &= coasts[:-ticks]
    for ticks in range(1, EARLY + 1):
        rest[:-ticks] &= coasts[ticks:]
    return rest


def truth_of(drive: Drive, history: dict[str, FloatColumn], road: Road, at_once: bool = False) -> Truth:
    """Return what is true on a drive's samples. history: the simulation's records, with `t_s`.

    at_once: a driveline is at rest as soon as it opens or closes, so that its force is known.
    """
    samples = drive.samples
    t = samples.t_us * 1e-6 - START_S
    speed, accel, distance, torque, engine = (
        np.interp(t, history["t_s"], history[name])
        for name in ("speed_mps", "accel_mps2", "distance_m", "indicated_Nm", "engine_radps")
    )
    friction = FRICTION_NM_PER_RADPS * engine
    at = np.clip(distance.astype(int), 0, ROAD_M - 1)
    mass = float(drive.mass_kg[0])
    rotating = 1.0 + samples.rotating_mass_kg / mass
    drives = np.isin(samples.gate, (Gate.OPEN, Gate.RECOVERY, Gate.RETARDER))
    per_force = 1.0 / (mass * rotating)
    coasts = np.isfinite(samples.coasting_N)
    known = drives | coasts if at_once else (drives & (samples.gate != Gate.RECOVERY)) | at_rest(coasts)
    by_torque = np.where(drives, samples.force_per_torque_1pm, 0.0) * per_force
    return Truth(
        mass_kg=mass,
        metres=speed * STEP_S,
        by_u=mass * (accel + GRAVITY_MPS2 * (road.sine[at] + samples.mu)) / rotating,
        by_torque=by_torque,
        by_friction=-by_torque,
        by_delay=np.where(drives, np.gradient(samples.traction_N, STEP_S), 0.0) * per_force,
        by_wind=-2.0 * samples.aero_N / np.maximum(speed, 1.0) * per_force,
        rotating=rotating,
        keeps=rounding_kept(torque),
        keeps_friction=rounding_kept(friction),
        known=known,
        curved=road.curved[at],
    )


def rounding_kept(torque_Nm: FloatColumn) -> FloatColumn:
    """Return the correlation of a torque's rounding error with that of the sample before, (n,).

    A rounding error is a sawtooth, whose autocorrelation is 1 - 6 d (1 - d) after d steps.
    """
    steps: FloatColumn = np.abs(np.diff(torque_Nm, prepend=torque_Nm[0])) / TORQUE_STEP_NM
    return np.exp(-6.0 * steps)


def bounds(truth: Truth, accelerometer: bool, told: bool) -> tuple[FloatColumn, FloatColumn]:
    """Return the bounds of the std of mass (a share of it) and of grade (a sine) after every sample, (n,).

        J[k+1] = (Q + F J[k]^-1 F')^-1 + H' R^-1 H

    (Tichavsky 1998, with the inversion lemma, since Q has no inverse), F and H at the true states.
    told: where the road is curved is known. Else the curvature is what it is in the mean of all roads, with
    the same mean, variance and correlation: this is what the best linear estimator reaches.
    """
    P = prior()
    of_speed = np.eye(STATES)[V]
    out = np.empty((2, len(truth.metres)))
    bends = False
    for k in range(len(truth.metres)):
        if told and bends != truth.curved[k]:
            bends = not bends
            fade(P, CURVATURE, 0.0, CONSTANTS.curvature_std_1pm**2 if bends else 0.0)
        F, noise = motion(truth, k, accelerometer)
        P = F @ P @ F.T
        P[V, V] += noise
        P[GRADE, GRADE] += CONSTANTS.smooth_wander_1pm * truth.metres[k]
        if bends or not told:
            fade(P, CURVATURE, *curvature(truth.metres[k], told))
        fade(P, TORQUE, truth.keeps[k], TORQUE_VAR)
        fade(P, FRICTION, truth.keeps_friction[k], TORQUE_VAR)
        fade(P, WIND, math.exp(-truth.metres[k] / CONSTANTS.wind_length_m), CONSTANTS.wind_std_mps**2)
        P = measured(P, of_speed, SPEED_VAR)
        if accelerometer and truth.known[k]:
            P = measured(P, sensed(truth, k), SENSED_VAR)
        out[:, k] = P[U, U], P[GRADE, GRADE]
    std = np.sqrt(out)
    return std[0] * truth.mass_kg, std[1]


def prior() -> Matrix:
    """Return the covariance before the first sample."""
    least, most = (1.0 / load for load in reversed(LOADS_KG))
    width = math.log(most / least)
    mean, square = (most - least) / width, 0.5 * (most * most - least * least) / width
    c, P = CONSTANTS, np.zeros((STATES, STATES))
    P[V, V], P[GRADE, GRADE], P[U, U] = START_V, START_GRADE_STD**2, square - mean * mean
    P[TORQUE, TORQUE] = P[FRICTION, FRICTION] = TORQUE_VAR
    P[OFFSET, OFFSET], P[DELAY, DELAY] = OFFSET_STD_NM**2, c.delay_std_s**2
    P[WIND, WIND], P[BIAS, BIAS] = c.wind_std_mps**2, c.bias_std_mps2**2
    return P


def motion(truth: Truth, k: int, accelerometer: bool) -> tuple[Matrix, float]:
    """Return F of a sample, and the variance that the speed gains.

    Where the force is unknown an accelerometer tells what it does, and without one nothing does.
    """
    F = np.eye(STATES)
    F[GRADE, CURVATURE] = truth.metres[k]
    if truth.known[k]:
        F[V, GRADE] = -GRAVITY_MPS2 * STEP_S / truth.rotating[k]
        for state, column in _ACTS:
            F[V, state] = getattr(truth, column)[k] * STEP_S
        return F, 0.0
    if accelerometer:
        F[V, GRADE], F[V, BIAS] = -GRAVITY_MPS2 * STEP_S, -STEP_S
        return F, SENSED_VAR * STEP_S**2
    return F, UNKNOWN_V


def curvature(metres: float, told: bool) -> tuple[float, float]:
    """Return what is left of a curvature after so many metres, as a share, and its variance."""
    c = CONSTANTS
    if told:
        return math.exp(-metres / c.curvature_length_m), c.curvature_std_1pm**2
    share = c.curved_length_m / (c.curved_length_m + c.straight_length_m)
    rate_1pm = 1.0 / c.curvature_length_m + 1.0 / c.curved_length_m
    return math.exp(-metres * rate_1pm), share * c.curvature_std_1pm**2


def fade(P: Matrix, state: int, left: float, variance: float) -> None:
    """Let a state go on, this share of it left, as a process of this variance."""
    P[state] *= left
    P[:, state] *= left
    P[state, state] += variance * (1.0 - left * left)


def sensed(truth: Truth, k: int) -> FloatColumn:
    """Return the row of H of the accelerometer: dv/dt + g theta + b."""
    h = np.zeros(STATES)
    h[GRADE], h[BIAS] = GRAVITY_MPS2 * (1.0 - 1.0 / truth.rotating[k]), 1.0
    for state, column in _ACTS:
        h[state] = getattr(truth, column)[k]
    return h


def measured(P: Matrix, h: FloatColumn, r: float) -> Matrix:
    """Return (P^-1 + h' h / r)^-1."""
    gain = P @ h
    found: Matrix = P - np.outer(gain, gain) / (h @ gain + r)
    return found
