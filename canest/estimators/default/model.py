"""The model: what the states are, and which hypotheses there are (docs/theory.md, sections 2 and 7).

A state "times u" is a product with the inverse mass, u = 1/M, so that it enters Newton's law linearly.
"""

from __future__ import annotations

from typing import Any, NamedTuple

#: states of every density
V = 0  #: speed, m/s
GRADE = 1  #: apparent grade: sine of the slope plus the error of the rolling resistance coefficient
U = 2  #: inverse mass, 1/kg
CURVATURE = 3  #: change of the grade per metre, 1/m; zero on a straight
ROLLING = 4  #: error of the rolling resistance coefficient
HEIGHT = 5  #: m
WIND = 6  #: headwind times u, (m/s)/kg
RATE = 7  #: drift of the inverse mass, 1/(kg s); zero where the load is steady
DELAY = 8  #: remaining delay of the reported torque times u, s/kg
WINDUP = 9  #: what a driveline gives way, or a lag of the torque smooths, times u, s2/kg
ANSWER = 10  #: share of the torque that answers the road, times u, 1/kg; zero where the driver is free
OFFSET = 11  #: crank torque that the report lacks beyond the usual, times u, N m/kg
BIAS = 12  #: offset of the accelerometer, m/s2
PITCH = 13  #: of the body, m/s2 of the accelerometer per m/s2
BEGIN = 14  #: speed where the window began, m/s
STATES = 15
STATES_WITHOUT_ACCELEROMETER = 12
#: products with the inverse mass, and what is in proportion to it
TIMES_U = (WIND, RATE, DELAY, WINDUP, ANSWER, OFFSET)

#: a mode: the road is straight, curved or rough; the driver is free, or the road answers the torque;
#: the load is steady or drifts. mode = road + ROADS * answered + STEADY_MODES * drifting
ROADS = 3
STRAIGHT, CURVED, ROUGH = range(ROADS)
STEADY_MODES = 2 * ROADS
MODES = 2 * STEADY_MODES
#: what a mode says besides the road: driver and drift
LASTING = MODES // ROADS
#: which modes have a curvature, a rough road, a driver whom the road answers, a drift (1 or 0); and all
BENDS = (0.0, 1.0, 1.0) * 4
IS_ROUGH = (0.0, 0.0, 1.0) * 4
ANSWERS = ((0.0,) * ROADS + (1.0,) * ROADS) * 2
DRIFTS = (0.0,) * STEADY_MODES + (1.0,) * STEADY_MODES
EVERYWHERE = (1.0,) * MODES
#: loads at most: the one there was, and others that it may have become
LOADS = 3
#: what is added to the number of a density's load where the disturbance is another
OTHER_DISTURBANCE = LOADS
#: densities at most, while a load begins
MOST = 2 * LOADS * MODES


class Mixture(NamedTuple):
    """The posterior: a sum of normal densities, each under one hypothesis. The first `count` are alive."""

    x: Any  #: (MOST, n) means, a view of A
    P: Any  #: (MOST, n, n) covariances, a view of A
    A: Any  #: (MOST, n, n + 1) [P | x]: a row of the transition matrix does the same to both
    load: Any  #: (MOST,) load and disturbance, whole; like all below a list interpreted, an array compiled
    mode: Any  #: (MOST,) whole
    weight: Any  #: (MOST,) probabilities
    found: Any  #: (MOST,) log likelihood of the window; zero where nothing speaks for a load


class Ends(NamedTuple):
    """What is measured at one moment."""

    speed_mps: float
    traction_N: float  #: what of it moves the vehicle: F_m = F_t / (1 + u J)
    traction_Nps: float  #: its rate, over the time of a window
    slips: float = 1.0  #: share of a slip that is in the speed: 1 / (1 + u J) of driven wheels, else 0


class Scratch(NamedTuple):
    """Room to work in: columns have one number per density."""

    f: Any  #: (4 * MOST,) entries of a row of the transition matrix
    K: Any  #: (n,) gain
    columns: Any  #: three columns
    e: Any  #: column: innovations of the last measurement
    s: Any  #: column: their variances
    loads: Any  #: (3 * LOADS,) weight, mean and variance of u of every load


class Space(NamedTuple):
    """All room to work in. Steps that need little get the scratch alone."""

    scratch: Scratch
    share: Any  #: (MODES * LOADS * MOST,) parts of every density in the densities of an exchange
    room: Mixture  #: those densities
    prior: Mixture  #: the MODES densities of an unknown load, with which all begins
    nodes: Any  #: inverse masses over which a wide mixture is summed


class Window(NamedTuple):
    """One window of 0.2 s: its measurements and known forces, NaN where there is none (see `windows`).

    The order is that of the columns of `Windows._windows`. Up to the altitude the fields of windows that are
    joined differ from those of the last one.
    """

    distance_m: float  #: negative in reverse
    begin_N: float  #: traction at its begin
    force_N: float  #: known forces, mean; the inertia of `rotating_kg` is not subtracted
    roll_mps2: float  #: g mu, mean
    accel_mps2: float  #: by the speed, mean
    drag_N_per_mps: float  #: aerodynamic force per m/s of wind, mean
    sensed_mps2: float  #: accelerometer, mean
    altitude_m: float  #: only where a new value came
    gap_s: float  #: time missing before it
    speed_mps: float  #: at its end
    traction_N: float  #: at its end
    undriven_mps: float  #: speed of an undriven axle at its end
    gear_1pm: float  #: force per crank torque
    rotating_kg: float
    open: float  #: 1 where no gate was closed
    retarding: float  #: 1 where nothing but a retarder of known force closed one
    stopped: float
    coarse: float  #: 1 where nothing but a bend, or the dwell after another gate, closed one
    bend_mps2: float  #: what a bend may brake there, std
    zigzag_Nm2s: float  #: what the torque takes back from report to report: density of its noise
    road_sine: float  #: slope by a road map, and its std
    road_std: float
    coast_mps2: float  #: acceleration of a coasting that has ended, and its variance
    coast_var: float
    coast_N: float  #: known forces on it
    coast_kg: float  #: what rotates with the wheels
    coast_back_s: float  #: time since its middle
