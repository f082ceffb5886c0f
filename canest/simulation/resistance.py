"""Road under the vehicle, mass on it, and the road load that follows."""

from __future__ import annotations

import math

from canest.core.jit import kernel
from canest.simulation.constants import CURVATURE, DISTANCE, GRADE, GRAVITY, MASS, SPEED
from canest.simulation.parameters import Course, ResistanceParameters
from canest.simulation.states import DRAG, FIXED, NEXT_CHANGE, ROAD_LOAD, State

STANDSTILL_MPS = 0.01  #: a load may change below it (chosen)


@kernel
def look_up_road(course: Course, x: State) -> None:
    """Set grade and curvature, linear between the metres; the last value goes on for ever."""
    grades = course.grades
    curvatures = course.curvatures
    distance = x[DISTANCE]
    end = len(grades) - 2
    at = int(distance)
    if at >= end:
        x[GRADE] = grades[end]
        x[CURVATURE] = curvatures[end]
    else:
        part = distance - at
        x[GRADE] = grades[at] + (grades[at + 1] - grades[at]) * part
        x[CURVATURE] = curvatures[at] + (curvatures[at + 1] - curvatures[at]) * part


@kernel
def load_cargo(course: Course, x: State, time_s: float) -> bool:
    """Change the mass when its time has come and the vehicle stands; return whether it changed."""
    if x[SPEED] >= STANDSTILL_MPS:
        return False
    change = int(x[NEXT_CHANGE])
    if change >= len(course.mass_times) or time_s < course.mass_times[change]:
        return False
    x[MASS] = course.masses[change]
    x[NEXT_CHANGE] = change + 1
    return True


@kernel
def set_road_load(p: ResistanceParameters, x: State, crr_extra: float, drag_scale: float) -> None:
    """Set F = m g (grade + crr) cos(beta) + cornering + drag + 1/2 rho Cd A (v + wind)^2."""
    mass = x[MASS]
    speed = x[SPEED]
    grade = x[GRADE]
    cosine = 1.0 / math.sqrt(1.0 + grade * grade)
    crr = p.crr + crr_extra + p.crr_per_mps * speed
    lateral = speed * speed * x[CURVATURE]
    cornering = mass * p.cornering * (lateral * lateral)
    fixed = mass * GRAVITY * (grade + crr) * cosine + cornering + p.drag_force
    drag = p.half_rho_cda * drag_scale
    air = speed + p.wind
    x[FIXED] = fixed
    x[DRAG] = drag
    x[ROAD_LOAD] = fixed + drag * air * abs(air)
