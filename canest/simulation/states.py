"""The state of a simulated vehicle: one vector in SI units, each number under its index.

The kernels change it in place; tuples built anew every 5 ms would double the time of a simulation. It begins
with the columns of a record (`canest.simulation.constants`). It is a list when the kernels are interpreted
and an array when they are compiled (see `canest.core.jit`), so that gears and phases may be floats there.
"""

from __future__ import annotations

from collections.abc import MutableSequence

from canest.simulation.constants import COLUMN_COUNT

State = MutableSequence[float]

# driveline in motion, integrated at 1 kHz with the speeds and torques of the record
INPUT_SPEED = COLUMN_COUNT  #: wheels seen through the gear, rad/s
TWIST = COLUMN_COUNT + 1  #: of the driveline, rad at the gearbox input
CLUTCH_TORQUE = COLUMN_COUNT + 2  #: N m

# engine control
BOOST = COLUMN_COUNT + 3  #: 0..1
RELEASED = COLUMN_COUNT + 4  #: share of the asked torque that a shift lets through, 0..1

# driver
BRAKING = COLUMN_COUNT + 5  #: 1 while the driver brakes
LIFTED = COLUMN_COUNT + 6  #: 1 while a throttle pulse is cut short
PUSHED = COLUMN_COUNT + 7  #: 1 while a throttle pulse is prolonged
EXPECTED = COLUMN_COUNT + 8  #: road load that the driver has come to expect, N

UNREPORTED = COLUMN_COUNT + 9  #: engine brake that nobody reports, N m at the crank

# clutch and gears; a gear is an index from 0
NEXT_GEAR = COLUMN_COUNT + 10
PHASE_S = COLUMN_COUNT + 11  #: time in this phase
SINCE_SHIFT_S = COLUMN_COUNT + 12

NEXT_CHANGE = COLUMN_COUNT + 13  #: index of the next change of the mass
PITCH_RATE = COLUMN_COUNT + 14  #: rad/s

# driveline in the present gear with the present mass
RATIO = COLUMN_COUNT + 15  #: crank to wheels
EFFICIENCY = COLUMN_COUNT + 16  #: undeclared losses included
TORQUE_PER_FORCE = COLUMN_COUNT + 17  #: crank torque per newton at the wheels by the declared efficiency, m
STIFFNESS = COLUMN_COUNT + 18  #: at the gearbox input, N m per rad
DAMPING = COLUMN_COUNT + 19  #: at the gearbox input, N m per rad/s
INERTIA = COLUMN_COUNT + 20  #: mass and wheels, kg
SLIP_GAIN = COLUMN_COUNT + 21  #: slip of the driven wheels per N m at the wheels

# road load, held for 5 ms
FIXED = COLUMN_COUNT + 22  #: all but the air's part, N
DRAG = COLUMN_COUNT + 23  #: half rho Cd A, kg/m
ROAD_LOAD = COLUMN_COUNT + 24  #: their sum at the beginning of the record, N

# what driver and control units go by at the beginning of a record
FRICTION = COLUMN_COUNT + 25  #: of the engine, N m
HIGHEST = COLUMN_COUNT + 26  #: full torque at this speed, N m
AVAILABLE = COLUMN_COUNT + 27  #: full torque with the present boost, N m
CEILING = COLUMN_COUNT + 28  #: torque at which the acceleration limit is reached, N m
PEDAL_UP = COLUMN_COUNT + 29  #: torque of a motor with the pedal up, N m
LEAST_FORCE = COLUMN_COUNT + 30  #: lowest force that the engine can give, N
TORQUE_ROW = COLUMN_COUNT + 31  #: row of the full-torque table at this speed
TAKEN = COLUMN_COUNT + 32  #: by accessories, losses and engine brakes, N m at the crank

STATE_SIZE = COLUMN_COUNT + 33
