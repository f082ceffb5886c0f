"""Noise levels, followed from the innovations; and the force that the model lacks."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.estimators.default.constants import Noise, Road, Vehicle
from canest.estimators.default.windows import WINDOW_S

_STEP_STD = math.sqrt(12.0)


class Levels(NamedTuple):
    """Noise levels and what they follow."""

    speed_var: float  #: variance of a speed, (m/s)2
    sensed_var: float  #: of the accelerometer, (m/s2)2
    ringing_N2: float  #: what a driveline's swing is proportional to
    windows: float  #: open windows so far
    nis_sum: float  #: sum of their normalised innovations squared
    roughness_1pm: float  #: variance that the grade gains per metre
    first: float  #: innovations of the three windows before, in stds; zero where they were closed
    second: float
    third: float


class Innovations(NamedTuple):
    """What the innovations of one window say, mean over the hypotheses."""

    nis: float  #: e^2 / s of the speed
    speed_surplus: float  #: e^2 - s, (m/s)2
    sensed_surplus: float  #: of the accelerometer, (m/s2)2
    innovation: float  #: of the speed, in stds


@jit.kernel
def unknown_force(traction: float, moved: float, step: float, drag: float, noise: Noise) -> float:
    """Return the density of the force that the model lacks, N2 s.

    moved: change of the traction in the window. step: std of the traction within the torque's resolution.
    drag: aerodynamic force per m/s of wind.
    """
    lasts_s = min(max(_STEP_STD * step / max(moved, 1.0), 1.0), noise.longest_windows) * WINDOW_S
    lacking = noise.force_share * traction if traction > 0.0 else -noise.overrun_share * traction
    gust = noise.gust_mps * drag
    return lacking * lacking * noise.force_s + step * step * lasts_s + 2.0 * gust * gust * noise.gust_s


@jit.kernel
def surplus(e: float, s: float, r: float, noise: Noise) -> float:
    """Return e^2 - s, outliers cut, less where s is mostly the states' own uncertainty."""
    share = min(noise.doubted * r / s, 1.0)
    return share * (min(e * e, noise.outlier * s) - s)


@jit.kernel
def wander(roughness_1pm: float, product: float, road: Road) -> float:
    """Return the variance that the grade gains per metre, after a window.

    product: of its innovation and the mean of the three before, in stds. Innovations of a right model are
    white (Kailath 1968): where the grade wanders more than the model allows, neighbours have one sign, and
    the roughness grows until they do not. Three neighbours, since a slow signal that is held makes two alike
    and the next ones unlike.
    """
    whole = math.log(road.roughest_1pm / road.roughness_1pm)
    smooth = math.log(road.roughest_1pm / roughness_1pm) / whole
    found = roughness_1pm * math.exp(road.whiteness * (product - road.alike * smooth * smooth))
    return min(max(found, road.roughness_1pm), road.roughest_1pm)


@jit.kernel
def follow(
    levels: Levels,
    found: Innovations,
    changed_N: float,
    is_open: bool,
    sees: bool,
    noise: Noise,
    road: Road,
    vehicle: Vehicle,
) -> Levels:
    """Return the levels after a window. changed_N: of the traction. sees: the accelerometer was used."""
    speed_var, sensed_var, ringing, windows, nis_sum, roughness, first, second, third = levels
    if is_open:
        windows += 1.0
        nis_sum += found.nis
        roughness = wander(roughness, found.innovation * (first + second + third) / 3.0, road)
        memory = min(noise.windows, noise.first_windows + windows)
        floor, loudest = vehicle.speed_floor_mps, vehicle.speed_loudest_mps
        speed_var = min(max(speed_var + found.speed_surplus / memory, floor * floor), loudest * loudest)
        if sees:
            floor = vehicle.sensed_floor_mps2
            sensed_var = max(sensed_var + found.sensed_surplus / memory, floor * floor)
        ringing = noise.ringing * ringing + changed_N * changed_N
    known = 1.0 if is_open else 0.0
    first, second, third = known * found.innovation, known * first, known * second
    return Levels(speed_var, sensed_var, ringing, windows, nis_sum, roughness, first, second, third)
