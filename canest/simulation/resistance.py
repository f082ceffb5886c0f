"""Road under the vehicle, mass on it, and the road load that follows."""

from __future__ import annotations

import math

from canest.core.jit import kernel
from canest.simulation.constants import GRAVITY
from canest.simulation.parameters import Course, ResistanceParameters
from canest.simulation.states import Cargo, Resistance

STANDSTILL_MPS = 0.01  #: a load may change below it (chosen)


@kernel
def road_at(course: Course, distance: float) -> tuple[float, float]:
    """Return grade and curvature, linear between the metres; the last value goes on for ever."""
    grades = course.grades
    curvatures = course.curvatures
    end = len(grades) - 2
    at = int(distance)
    if at >= end:
        grade = grades[end]
        curvature = curvatures[end]
    else:
        part = distance - at
        grade = grades[at] + (grades[at + 1] - grades[at]) * part
        curvature = curvatures[at] + (curvatures[at + 1] - curvatures[at]) * part
    return grade, curvature


@kernel
def cargo_at(course: Course, cargo: Cargo, time_s: float, speed: float) -> Cargo:
    """Return the mass, changed when its time has come and the vehicle stands."""
    change = cargo.next_change
    if change < len(course.mass_times) and time_s >= course.mass_times[change] and speed < STANDSTILL_MPS:
        return Cargo(course.masses[change], change + 1)
    return cargo


@kernel
def road_load(
    p: ResistanceParameters, mass: float, speed: float, grade: float, curvature: float, crr_extra: float,
    drag_scale: float,
) -> Resistance:  # fmt: skip
    """Return F = m g (grade + crr) cos(beta) + cornering + drag + 1/2 rho Cd A (v + wind)^2."""
    cosine = 1.0 / math.sqrt(1.0 + grade * grade)
    crr = p.crr + crr_extra + p.crr_per_mps * speed
    lateral = speed * speed * curvature
    cornering = mass * p.cornering * (lateral * lateral)
    fixed = mass * GRAVITY * (grade + crr) * cosine + cornering + p.drag_force
    drag = p.half_rho_cda * drag_scale
    air = speed + p.wind
    return Resistance(fixed, drag, fixed + drag * air * abs(air))
