"""How near does the default estimator come to the Cramér-Rao bound, on drives without any undeclared effect?

    python benchmarks/cramer_rao.py [--drives 40] [--seed 7600] [--driver NAME]... [--json FILE]
    python benchmarks/cramer_rao.py -o docs/measured/cramer-rao.md

The bound is that of van Trees for a random state, by the recursion of Tichavsky, Muravchik and Nehorai (1998),
along the true states of each drive. It is written from the equations of motion and shares no code with the
estimator. It knows more than any estimator can: where the road is curved, the pitch, the delay of the torque.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from judging import Drive, estimate, prepare
from numpy.typing import NDArray
from tables import Run, page_head

from canest.core import jit
from canest.core.frames import BoolColumn, FloatColumn
from canest.core.gates import Gate
from canest.core.samples import GRAVITY_MPS2, STEP_S
from canest.estimators.default.constants import CONSTANTS
from canest.simulation.run import simulate

DRIVERS: dict[str, dict[str, Any]] = {
    "pulses": {"kind": "pulses"},
    "pulses, one gear": {"kind": "pulses", "start_mps": 21.0, "fixed_gear": 10, "max_mps": 26.0, "min_mps": 16.0,
                         "on_s": [8, 14], "off_s": [4, 8]},
    "mixed": {"kind": "mixed", "retarder": True},
}  # fmt: skip
DURATION_S, START_KG = 300.0, 21000.0
#: parts of a drive that are compared, s
PARTS_S = ((30.0, 60.0), (60.0, 120.0), (120.0, DURATION_S))
#: loads, uniform in their logarithm; the mean and std of their inverse
LOADS_KG = (9000.0, 36000.0)
#: no road is steeper (in one gear a truck must get up it), how a road begins, and how much of one is laid, m
STEEPEST = {"pulses": 0.04, "pulses, one gear": 0.02, "mixed": 0.04}
START_GRADE_STD, ROAD_M = 0.01, 12_000
#: std of the wheel speed by the shaft's, of torque and of the accelerometer by their resolution, of the bias
SHAFT_NOISE_RPM, SHAFT_STEP_RPM, MPS_PER_RPM = 0.4, 0.125, 2.0 * math.pi / 60.0 / 3.73 * 0.5
TORQUE_STEP_NM = 21.0
TORQUE_VAR = TORQUE_STEP_NM**2 / 12.0
SENSED_NOISE_MPS2, SENSED_STEP_MPS2 = 0.06, 0.1
#: variance of a speed that an unknown force has led to, (m/s)2
UNKNOWN_V = 100.0
V, GRADE, CURVATURE, U, TORQUE, BIAS = range(6)
#: when a simulated drive begins
START_S = 1_700_000_000
FIGURES = ("mass", "grade")

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Road:
    """A road of the model's own process: metre by metre its sine and where it is curved."""

    sine: FloatColumn
    curved: BoolColumn


def road(rng: np.random.Generator, steepest: float) -> Road:
    """Draw a road: straight or curved by turns, its curvature an Ornstein-Uhlenbeck process, its grade a walk.

    A stretch that would lead beyond the steepest grade is drawn again.
    """
    c = CONSTANTS
    left = math.exp(-1.0 / c.curvature_length_m)
    kick = c.curvature_std_1pm * math.sqrt(1.0 - left * left)
    sine, curved = np.empty(ROAD_M), np.zeros(ROAD_M, np.bool_)
    sine[0] = rng.normal(0.0, START_GRADE_STD)
    at, bends = 1, False
    while at < ROAD_M:
        length = min(1 + int(rng.exponential(c.curved_length_m if bends else c.straight_length_m)), ROAD_M - at)
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


def scenario(driver: str, seed: int) -> tuple[dict[str, Any], Road]:
    """Draw a drive with nothing undeclared."""
    rng = np.random.default_rng(seed)
    found = road(rng, STEEPEST[driver])
    grade = found.sine / np.sqrt(1.0 - found.sine**2)
    return {
        "seed": seed,
        "duration_s": DURATION_S,
        "vehicle": "class8",
        "mass_kg": float(np.exp(rng.uniform(*np.log(LOADS_KG)))),
        "road": {"kind": "points", "at_m": list(range(ROAD_M)), "grade": grade.round(7).tolist()},
        "driver": DRIVERS[driver],
        "sensors": {"accelerometer_bias_mps2": float(rng.normal(0.0, CONSTANTS.bias_std_mps2))},
    }, found


def exact(drive: Drive) -> Drive:
    """Return the drive without altitude, of a vehicle whose facts are stated as exact, as they are."""
    facts = replace(
        drive.facts,
        torque_accuracy=0.0,
        wheel_radius_accuracy=0.0,
        rolling_resistance_accuracy=0.0,
        drag_area_accuracy=0.0,
    )
    unknown = np.full(len(drive.samples), np.nan)
    return replace(drive, facts=facts, samples=replace(drive.samples, altitude_m=unknown))


def bounds(
    drive: Drive, history: dict[str, FloatColumn], found: Road, accelerometer: bool, told: bool
) -> tuple[FloatColumn, FloatColumn]:
    """Return the bounds of the std of mass (a share of it) and of grade (a sine) after every sample, (n,).

        J[k+1] = (Q + F J[k]^-1 F')^-1 + H' R^-1 H

    (Tichavsky 1998, with the inversion lemma, since Q has no inverse), F and H at the true states.
    told: where the road is curved is known. Else the curvature is what it is in the mean of all roads, with
    the same mean, variance and correlation: this is what the best linear estimator reaches.
    """
    c, samples = CONSTANTS, drive.samples
    t = samples.t_us * 1e-6 - START_S
    speed, accel, distance = (
        np.interp(t, history["t_s"], history[name]) for name in ("speed_mps", "accel_mps2", "distance_m")
    )
    at = np.clip(distance.astype(int), 0, ROAD_M - 1)
    mass = float(drive.mass_kg[0])
    rotating = 1.0 + samples.rotating_mass_kg / mass
    #: (F - J a) / (1 + u J), the acceleration by a unit of u
    lever = mass * (accel + GRAVITY_MPS2 * (found.sine[at] + samples.mu)) / rotating
    known = knows_force(drive)
    per_torque = samples.force_per_torque_1pm / mass / rotating
    moved = np.abs(np.diff(np.interp(t, history["t_s"], history["indicated_Nm"]), prepend=0.0))
    keeps = np.exp(-moved / TORQUE_STEP_NM)
    n = 6 if accelerometer else 5
    P = prior(mass)[:n, :n]
    length_m, curvature_var = c.curvature_length_m, c.curvature_std_1pm**2
    if not told:
        curvature_var *= c.curved_length_m / (c.curved_length_m + c.straight_length_m)
        length_m = 1.0 / (1.0 / length_m + 1.0 / c.curved_length_m)
    speed_var = MPS_PER_RPM**2 * (SHAFT_NOISE_RPM**2 + SHAFT_STEP_RPM**2 / 12.0)
    sensed_var = SENSED_NOISE_MPS2**2 + SENSED_STEP_MPS2**2 / 12.0
    of_speed, of_sensed = np.eye(n)[V], np.zeros(n)
    F, Q = np.eye(n), np.zeros(n)
    out = np.empty((2, len(t)))
    bends = False
    for k in range(len(t)):
        metres = speed[k] * STEP_S
        F[V] = of_speed
        F[GRADE, CURVATURE] = metres
        if known[k]:
            F[V, GRADE], F[V, U] = -GRAVITY_MPS2 * STEP_S / rotating[k], lever[k] * STEP_S
            F[V, TORQUE] = per_torque[k] * STEP_S
            Q[V] = 0.0
        elif accelerometer:  # it tells what the force does
            F[V, GRADE], F[V, BIAS] = -GRAVITY_MPS2 * STEP_S, -STEP_S
            Q[V] = sensed_var * STEP_S**2
        else:
            Q[V] = UNKNOWN_V
        if told and bends != found.curved[at[k]]:
            bends = not bends
            P[CURVATURE] = P[:, CURVATURE] = 0.0
            P[CURVATURE, CURVATURE] = curvature_var if bends else 0.0
        P = F @ P @ F.T
        if bends or not told:
            left = math.exp(-metres / length_m)
            P[CURVATURE] *= left
            P[:, CURVATURE] *= left
            P[CURVATURE, CURVATURE] += curvature_var * (1.0 - left * left)
        P[TORQUE] *= keeps[k]
        P[:, TORQUE] *= keeps[k]
        Q[TORQUE] = TORQUE_VAR * (1.0 - keeps[k] ** 2)
        Q[GRADE] = c.smooth_wander_1pm * metres
        P = measured(P + np.diag(Q), of_speed, speed_var)
        if accelerometer and known[k]:
            of_sensed[GRADE] = GRAVITY_MPS2 * (1.0 - 1.0 / rotating[k])
            of_sensed[U], of_sensed[TORQUE], of_sensed[BIAS] = lever[k], per_torque[k], 1.0
            P = measured(P, of_sensed, sensed_var)
        out[:, k] = P[U, U], P[GRADE, GRADE]
    std = np.sqrt(out)
    return std[0] * mass, std[1]


def prior(mass_kg: float) -> Matrix:
    """Return the covariance before the first sample, with bias."""
    least, most = (1.0 / load for load in reversed(LOADS_KG))
    width = math.log(most / least)
    mean, square = (most - least) / width, 0.5 * (most * most - least * least) / width
    std = [10.0, START_GRADE_STD, 0.0, math.sqrt(square - mean * mean), math.sqrt(TORQUE_VAR)]
    return np.diag(np.square([*std, CONSTANTS.bias_std_mps2]))


def measured(P: Matrix, h: FloatColumn, r: float) -> Matrix:
    """Return (P^-1 + h' h / r)^-1."""
    gain = P @ h
    found: Matrix = P - np.outer(gain, gain) / (h @ gain + r)
    return found


def knows_force(drive: Drive) -> BoolColumn:
    """Return where the force is known: gates open, or closed for what hides none, or coasting."""
    gate = drive.samples.gate
    return np.isin(gate, (Gate.OPEN, Gate.RECOVERY, Gate.RETARDER)) | np.isfinite(drive.samples.coasting_N)


