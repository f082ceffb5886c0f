"""Road under the vehicle, mass on it, and the road load that follows."""

from __future__ import annotations

import math

from canest.core.jit import kernel
from canest.simulation.constants import CURVATURE, DISTANCE, GRADE, GRAVITY, MASS, RECORD_S, SPEED
from canest.simulation.parameters import Course, Plan, ResistanceParameters
from canest.simulation.states import DRAG, FIXED, NEXT_CHANGE, ROAD_LOAD, State

STANDSTILL_MPS = 0.01  #: the vehicle stands below it (chosen)


@kernel
def load_cargo(course: Course, x: State, time_s: float) -> bool:
    """Set the mass of a change that is due, or add what 5 ms in motion add; return whether it changed."""
    standing = x[SPEED] < STANDSTILL_MPS
    change = int(x[NEXT_CHANGE])
    if time_s >= course.mass_times[change]:
        due = change if standing else last_in_motion(course, change, time_s)
        if due >= 0:
            x[MASS] = course.masses[due]
            x[NEXT_CHANGE] = due + 1
            return True
    rate = course.mass_rates[change - 1]
    if standing or rate == 0.0:
        return False
    x[MASS] += rate * RECORD_S
    return True


@kernel
def last_in_motion(course: Course, change: int, time_s: float) -> int:
    """Return the last change from `change` on that is due in motion, -1 for none.

    It takes the place of earlier ones that no standstill has let happen.
    """
    found = -1
    while time_s >= course.mass_times[change]:
        if course.mass_in_motion[change] > 0.0:
            found = change
        change += 1
    return found


@kernel
def set_road_load(p: ResistanceParameters, course: Course, plan: Plan, x: State) -> None:
    """Set grade, curvature, and F = m g (grade + crr) cos(beta) + cornering + drag + 1/2 rho Cd A (v + w)^2.

    w: wind. The road is linear between the metres; its last value goes on for ever.
    """
    grades = course.grades
    curvatures = course.curvatures
    distance = x[DISTANCE]
    end = len(grades) - 2
    at = int(distance)
    if at >= end:
        grade = grades[end]
        curvature = curvatures[end]
    else:
        part = distance - at
        grade = grades[at] + (grades[at + 1] - grades[at]) * part
        curvature = curvatures[at] + (curvatures[at + 1] - curvatures[at]) * part
    mass = x[MASS]
    speed = x[SPEED]
    cosine = 1.0 / math.sqrt(1.0 + grade * grade)
    crr = p.crr + plan.crr_extra + p.crr_per_mps * speed
    lateral = speed * speed * curvature
    cornering = mass * p.cornering * (lateral * lateral)
    fixed = mass * GRAVITY * (grade + crr) * cosine + cornering + p.drag_force
    drag = p.half_rho_cda * plan.drag_scale
    air = speed + p.wind
    x[GRADE] = grade
    x[CURVATURE] = curvature
    x[FIXED] = fixed
    x[DRAG] = drag
    x[ROAD_LOAD] = fixed + drag * air * abs(air)
