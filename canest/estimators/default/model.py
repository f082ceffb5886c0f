"""The model: what the states are, and what moves and measures them (docs/theory.md, sections 2 to 4).

Newton's law divided by the mass is linear in the inverse mass u = 1/M and in every product with it:

    d/dt [(1 + u J) v] = u F - g (mu + theta) - c (u w)

F known forces (N), J mass of what rotates (kg), g mu rolling resistance, theta the apparent grade, c the
aerodynamic force per m/s of wind w. A state "times u" is such a product.
"""

from __future__ import annotations

from typing import NamedTuple

#: states of every filter
Q = 0  #: momentum per mass (1 + u J) v, m/s
GRADE = 1  #: apparent grade: sine of the slope plus the error of the rolling resistance coefficient
CURVATURE = 2  #: change of the grade per metre, 1/m; zero on a straight road
RESPONSE = 3  #: how the road answers a change of force, less u, 1/kg; zero where it does not
WIND = 4  #: headwind times u, (m/s)/kg
DELAY = 5  #: remaining delay of the reported torque times u, s/kg
SLIP = 6  #: slip of the driven wheels per traction times u
WINDUP = 7  #: compliance of the driveline times u
HEIGHT = 8  #: m
ROLLING = 9  #: error of the rolling resistance coefficient
U = 10  #: inverse mass, 1/kg
RATE = 11  #: drift of the inverse mass, 1/(kg s); zero where the load does not drift
BIAS = 12  #: offset of the accelerometer, m/s2
PITCH = 13  #: g times pitch of the body per m/s2
LAG = 14  #: delay of the accelerometer times u, s/kg
STATES = 15
STATES_WITHOUT_ACCELEROMETER = 12

#: modes of a load hypothesis: the road is straight or curved; torque is free, or the road answers it
MODES = 4
STRAIGHT_FREE, CURVED_FREE, STRAIGHT_ANSWERED, CURVED_ANSWERED = range(MODES)


class Window(NamedTuple):
    """One window of 0.2 s, its measurements and known forces (see `windows`)."""

    gap_s: float
    distance_m: float
    before_mps: float
    before_N: float
    before_Nps: float
    speed_mps: float
    force_N: float
    traction_N: float
    traction_Nps: float
    roll_mps2: float
    accel_mps2: float
    drag_N_per_mps: float
    gear_1pm: float
    rotating_kg: float
    undriven_mps: float
    sensed_mps2: float
    altitude_m: float
    open: float
    retarding: float
    stopped: float
    coarse: float
    bend_mps2: float
    road_sine: float
    road_std: float
    coast_mps2: float
    coast_var: float
    coast_N: float
    coast_kg: float
    coast_back_s: float
