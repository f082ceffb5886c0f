"""The model: what the states are, and which hypotheses there are (docs/theory.md, sections 2 and 7).

Newton's law divided by the mass, with u = 1/M:

    dv/dt = (u F - g mu - g theta - c omega) / (1 + u J)

F known forces (N), J mass of what rotates (kg), g mu rolling resistance, theta apparent grade, c aerodynamic
force per m/s of headwind. A state "times u" is a product with the inverse mass: it enters linearly.
"""

from __future__ import annotations

from typing import Any, NamedTuple

#: states of every density
V = 0  #: speed, m/s
GRADE = 1  #: apparent grade: sine of the slope plus the error of the rolling resistance coefficient
HEIGHT = 2  #: m
U = 3  #: inverse mass, 1/kg
CURVATURE = 4  #: change of the grade per metre, 1/m
RESPONSE = 5  #: how the road answers a change of force, less u, 1/kg
WIND = 6  #: headwind times u, (m/s)/kg
ROLLING = 7  #: error of the rolling resistance coefficient
RATE = 8  #: drift of the inverse mass, 1/(kg s)
DELAY = 9  #: remaining delay of the reported torque times u, s/kg
SLIP = 10  #: slip of the driven wheels per N of traction
WINDUP = 11  #: compliance of the driveline times u
BIAS = 12  #: offset of the accelerometer, m/s2
PITCH = 13  #: g times pitch of the body per m/s2
STATES = 14
STATES_WITHOUT_ACCELEROMETER = 12

#: the road is straight, curved or rough; the driver is free, or the road answers the force; the load is steady
#: or drifts
ROADS = 6
STRAIGHT, CURVED, ROUGH, STRAIGHT_ANSWERED, CURVED_ANSWERED, ROUGH_ANSWERED = range(ROADS)
MODES = 2 * ROADS  #: mode = road + ROADS * drifting
#: which modes have a curvature, a rough road, a response, a drift (1 or 0)
BENDS = (0.0, 1.0, 1.0) * 4
ROUGHS = (0.0, 0.0, 1.0) * 4
ANSWERS = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0) * 2
DRIFTS = (0.0,) * 6 + (1.0,) * 6


class Bank(NamedTuple):
    """Normal densities, each under one hypothesis; the first `count` of them are alive."""

    x: Any  #: (most, n) means
    P: Any  #: (most, n, n) covariances
    weight: Any  #: (most,) probabilities
    load: Any  #: (most,) which load: a number
    mode: Any  #: (most,) road + ROADS * drifting
    found: Any  #: (most,) log likelihood of the window


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
