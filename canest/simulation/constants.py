"""Units, time steps, columns of a record, phases of the driveline."""

from __future__ import annotations

import math

GRAVITY = 9.80665  #: m/s2, standard gravity (ISO 80000-3)
RPM = 60 / (2 * math.pi)  #: rpm per rad/s
RADPS = 2 * math.pi / 60  #: rad/s per rpm
KMH = 3.6  #: km/h per m/s
PERCENT = 100

STEP_S = 0.001  #: physics: a tenth of the fastest time constant
STEPS_PER_RECORD = 5
RECORD_S = STEP_S * STEPS_PER_RECORD  #: driver, gearbox and records
PLAN_S = 0.1  #: spacing of what is planned: wanted speed, throttle, drafting, switched loads
RECORDS_PER_PLAN_STEP = round(PLAN_S / RECORD_S)
TORQUE_TABLE_RPM = 25.0  #: spacing of the full-torque table
BRAKE_LIGHT = 0.003  #: share of full braking from which the brake switch closes (chosen)

#: columns of a record
COLUMNS = (
    "speed_mps", "accel_mps2", "distance_m", "engine_radps", "wheel_radps", "indicated_Nm", "demand_Nm",
    "wheel_torque_Nm", "pedal", "brake", "retarder_Nm", "gear", "phase", "clutch_slip", "mass_kg", "load_on",
    "pitch_rad", "grade", "curvature_1pm", "crank_Nm",
)  # fmt: skip
COLUMN_COUNT = len(COLUMNS)
(SPEED, ACCEL, DISTANCE, ENGINE_SPEED, WHEEL_SPEED, INDICATED, DEMAND,
 WHEEL_TORQUE, PEDAL, BRAKE, RETARDER, GEAR, PHASE, CLUTCH_SLIP, MASS, LOAD_ON,
 PITCH, GRADE, CURVATURE, CRANK_TORQUE) = range(COLUMN_COUNT)  # fmt: skip

#: phases of the driveline
ENGAGED, RAMP_OUT, NEUTRAL, RAMP_IN, LAUNCH, STANDING = range(6)
#: phases in which the clutch is closed
CLOSED = (ENGAGED, RAMP_OUT, RAMP_IN)
