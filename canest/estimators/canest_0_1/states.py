"""Where things lie in the containers of `canest`'s kernels: states, memory, outputs."""

from __future__ import annotations

# states of one filter; those below FREE are the driveline's, which closed gates freeze
Q, U, DELAY, SLIP, WIND, WINDUP = range(6)
GRADE, CURVATURE, HEIGHT, BIAS, PITCH, SENSE_LAG = range(6, 12)
FREE = GRADE
#: without an accelerometer the last three have no use
BASE_STATES, STATES = 9, 12

# kinds of road: of constant grade, or a crest or sag of constant curvature
STRAIGHT, CURVED = range(2)
ROADS = 2

# states of the undriven axle's own small filter
AXLE_SLIP, AXLE_LAG, AXLE_SCALE = range(3)
AXLE_STATES = 3

# carried beside the states
(
    SINCE,  # windows since the momentum balance began, 0 where it must begin anew
    STANDING_S,
    HAS_HEIGHT,
    LEARNED,
    SPEED_VAR,
    SENSED_VAR,
    UNDRIVEN_VAR,
    BIASED,  # running mean of the normalised innovation
    COUNT,
    NIS_SUM,
    POSITIVE,
    RUNS,
    SIGN,
    CALM_MPS,  # speed without its recent noise
    EFFORT,  # what torque faster than roads has told of mass since it was opened, m2/s3
    FELT,  # the same of slower torque, where an accelerometer feels the road
    STEADY_N,  # force that changes no faster than roads do
    SLOW_N,  # force that changes no faster than an accelerometer's bias
    LAST_MPS2,  # acceleration in the window before
    STRETCH_M,  # travelled since the roads were last mixed
    UNSEEN,  # windows since an accelerometer was read
    HELD_U,  # the inverse mass of the last open window: a closed gate moves no mass
    COARSE_GRADE,  # what follows the filter's grade and takes coarse forces too, and its variance
    COARSE_VAR,
    LAST_GRADE,  # the filter's in the window before
    LAST_VAR,
    SURPRISED_M,  # travelled since innovations were last one-signed for long
    PRESSED,  # how far beyond its bounds the inverse mass would be, had nobody held it
    BENT_M,  # travelled in curves, and the sum of their curvature squared, 1/m
    BENT_1PM,
    LASTING_U,  # the inverse mass that lasts, and for how long it has, open gates only
    LASTED_S,
    BEFORE_U,  # the one before the load may have changed (one that had lasted, if any had), 0 for none
    HERE_M,  # travelled on this stretch of road, and the effort that was credited on it
    HERE_EFFORT,
    SINCE_STOOD_M,  # travelled since the vehicle last stood
    SENSED_SUM,  # accelerometer and acceleration of this second, its windows, and the means of the one before
    ACCEL_SUM,
    SUMMED,
    SENSED_BEFORE,
    ACCEL_BEFORE,
    SHAKES,  # changes of the acceleration squared, and times what the accelerometer felt of them
    SHAKEN,
    DEAF,  # 1 while it does not feel what the vehicle does
    RINGING,  # shoves of torque that still ring in the driveline, squared, N2
    SWING_VAR,  # and how much it swings then, (m/s per N)2
    COAST_MPS2,  # the last coasting that no open gate has taken yet: acceleration, its variance (0: none),
    COAST_VAR,
    COAST_N,  # force, what rotates with the wheels, and how far back it was
    COAST_KG,
    COAST_BACK_M,
    SAME_U,  # the inverse mass from before a stop that may have changed it, and its variance (0: none)
    SAME_VAR,
    GIVEN_VAR,  # variance of the inverse mass that is given out, with all its doubts, and which share of what
    LEFT,  # the filter alone would leave in doubt that is
) = range(55)
MEMORY = 55

# one window's outputs
OUT_U, OUT_U_VAR, OUT_GRADE, OUT_CURVATURE, OUT_GRADE_VAR, OUT_LEARNED, OUT_STANDING_S, OUT_UNTOLD = range(8)
OUT_STEADY_MPS2, OUT_PROVEN = range(8, 10)
OUTPUTS = 10
