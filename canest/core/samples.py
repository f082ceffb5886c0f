"""What the vehicle model hands to every estimator, and what every estimator hands back."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import BoolColumn, FloatColumn, IntColumn

GRAVITY_MPS2 = 9.80665
STEP_US = 20_000  #: one tick of the 50 Hz grid
STEP_S = 0.02
RATE_HZ = 50.0
LOADING_S = 30.0  #: a vehicle that stands this long may have been loaded


class Status(IntEnum):
    """What an estimate may be used for (codes of `dbc/canest.dbc`)."""

    UNESTIMATED = 0  #: no estimate yet; the numbers are NaN, or a start value nobody has confirmed
    CONVERGING = 1  #: an estimate, not yet trusted
    VALID = 2  #: trusted within its standard deviation


STATUS_LABELS = {int(s): s.name.lower() for s in Status}


@dataclass(frozen=True, slots=True, eq=False)
class ModelBlock:
    """Consecutive 50 Hz samples of the longitudinal model, all columns of equal length n.

    The model is  M (a + g sin(beta) + g mu cos(beta)) = F,  so that F / M and the grade part the data.
    Every "filtered" column has passed the same Butterworth, so the relation stays exact for constant
    M and beta (the regression is filtered, not only the signals).

    t_us: int64, stamp of the tick (an integer multiple of 20 ms).
    speed_mps: speed over ground along the road, filtered.
    accel_mps2: its derivative over the last tick, (v[k] - v[k-1]) / dt, filtered.
    force_N: F, all known forces along the road but gravity and rolling resistance: traction less
        rotating inertia, aerodynamic drag, retarder and every effect of the config; mean over the last
        tick, filtered. Uphill driving needs F > 0.
    mu: rolling resistance coefficient (with effects), dimensionless, filtered.
    traction_N: the part of F that comes from the reported engine torque, filtered.
    aero_N: the part of F that is aerodynamic drag (positive against the motion), filtered.
    force_per_torque_1pm: d(traction)/d(net crank torque) = ratio x losses / radius, where the losses are the
        efficiency, or 1 / efficiency in overrun (as in `force_N`); unfiltered.
    rotating_mass_kg: effective mass of wheels and engine inertia in this gear while the engine drives,
        unfiltered. It does not change in overrun, so the momentum (M + rotating mass) x speed does not jump;
        what overrun takes more of the engine's inertia is a force in `force_N`.
    coasting_N: known forces on a vehicle that coasts with its driveline open (neither engine nor brakes reach
        the road), rotating inertia not subtracted, unfiltered; NaN where it does not. There
        `rotating_mass_kg` is that of the wheels alone.
    undriven_mps: speed of an undriven axle, filtered; NaN without one.
    accelerometer_mps2: longitudinal accelerometer, filtered; NaN without one. Not gated by the driveline.
    slope: measured grade (slope sensor), ratio, as last sent; NaN without one.
    altitude_m: altitude as last sent; NaN without.
    yaw_rate_radps: NaN without.
    raw_speed_mps, raw_force_N: as `speed_mps` and `force_N`, before the Butterworth; NaN where not known
        (the filtered columns repeat themselves there).
    raw_torque_Nm: net torque at the crank, or at the wheels where the vehicle measures it there, unfiltered;
        NaN where not known.
    gear: the gear that the model uses, negative in reverse; 0 where none is engaged or known.
    gate: uint8 code of `canest.core.gates.Gate`; 0 where the estimator may learn.
    restart: True on a sample whose predecessor was gated or missing (windows and differences start anew).
    stopped: True while the vehicle stands, as derived from speed and clutch state.
    ax_ok: True where accelerometer and speed are usable together (not gated by the driveline).
    road_sine, road_std: sine of the slope by a road map and its standard deviation, NaN where the vehicle is
        on no road of it; None without a map.
    lever_std: standard deviation of ratio and radius, as a share, beyond what is declared: speeds of the bus
        contradict them by that. 0 where they agree or nothing is known yet; None where nothing can show it.
    """

    t_us: IntColumn
    speed_mps: FloatColumn
    accel_mps2: FloatColumn
    force_N: FloatColumn
    mu: FloatColumn
    traction_N: FloatColumn
    aero_N: FloatColumn
    force_per_torque_1pm: FloatColumn
    rotating_mass_kg: FloatColumn
    coasting_N: FloatColumn
    undriven_mps: FloatColumn
    accelerometer_mps2: FloatColumn
    slope: FloatColumn
    altitude_m: FloatColumn
    yaw_rate_radps: FloatColumn
    raw_speed_mps: FloatColumn
    raw_force_N: FloatColumn
    raw_torque_Nm: FloatColumn
    gear: FloatColumn
    gate: NDArray[np.uint8]
    restart: BoolColumn
    stopped: BoolColumn
    ax_ok: BoolColumn
    road_sine: FloatColumn | None = None
    road_std: FloatColumn | None = None
    lever_std: FloatColumn | None = None

    def __len__(self) -> int:
        return len(self.t_us)

    def __getitem__(self, index: slice | NDArray[np.bool_] | IntColumn) -> ModelBlock:
        """Return the selected samples."""
        columns: list[Any] = [getattr(self, f.name) for f in fields(self)]
        selected: list[Any] = [None if column is None else column[index] for column in columns]
        return ModelBlock(*selected)

    @staticmethod
    def concatenate(blocks: list[ModelBlock]) -> ModelBlock:
        """Join blocks in order (at least one)."""
        names = (f.name for f in fields(ModelBlock) if getattr(blocks[0], f.name) is not None)
        return ModelBlock(**{name: np.concatenate([getattr(b, name) for b in blocks]) for name in names})


@dataclass(frozen=True, slots=True, eq=False)
class EstimateBlock:
    """Estimates, one per sample of a `ModelBlock`; NaN where there is no number yet.

    mass_kg, mass_std_kg: float64; grade, grade_std: float64, ratio tan(beta); status: uint8 `Status`.
    """

    mass_kg: FloatColumn
    mass_std_kg: FloatColumn
    grade: FloatColumn
    grade_std: FloatColumn
    status: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.mass_kg)


@dataclass(frozen=True, slots=True)
class VehicleFacts:
    """What an estimator may know of the vehicle beyond the samples (all from the config).

    mass_min_kg, mass_max_kg: bounds of the gross mass, for projection and as the prior's range.
    initial_mass_kg: start value given by the user, or None: choose by yourself.
    rolling_resistance: coefficient of the config. pitch_rad_per_mps2: body pitch (squat) per m/s2.
    speed_step_mps, torque_step_Nm, accelerometer_step_mps2: resolution of the signals in use.
    has_road_map: whether samples may have the slope of a road map.
    filter_delay_s: how much later than the vehicle the filtered columns are.
    report_period_s: time between two reports of the slowest of speed and torque, 0 where they are fast.
        Between two reports a signal is a line, so that what is measured is at its ends.
    torque_accuracy, wheel_radius_accuracy, rolling_resistance_accuracy, drag_area_accuracy: how well each is
        known, one standard deviation as a fraction of its value (2 % in the config is 0.01).
    unreported_torque_Nm: crank torque that the reported torque lacks, its mean and its standard deviation.
    slips: whether the speed is that of driven wheels, and no effect of the model has taken their slip off.
    torque_lags: whether the torque may lag its report, as an engine's does and an electric motor's does not.
    valid_std: the mass may be valid while its standard deviation is below this fraction of it.
    waits_s: the part of `filter_delay_s` by which raw columns are late as well: slow signals are waited for.
    knows_retarder: whether the force has what a retarder takes that is reported.
    """

    mass_min_kg: float
    mass_max_kg: float
    initial_mass_kg: float | None = None
    initial_grade: float | None = None
    rolling_resistance: float = 0.006
    pitch_rad_per_mps2: float | None = None
    speed_step_mps: float = 0.002
    torque_step_Nm: float = 20.0
    accelerometer_step_mps2: float = 0.1
    has_accelerometer: bool = False
    has_road_map: bool = False
    filter_delay_s: float = 0.0
    report_period_s: float = 0.0
    torque_accuracy: float = 0.025
    unreported_torque_Nm: float = 3.0
    wheel_radius_accuracy: float = 0.01
    rolling_resistance_accuracy: float = 0.15
    drag_area_accuracy: float = 0.10
    slips: bool = True
    torque_lags: bool = True
    valid_std: float = 0.045
    waits_s: float = 0.0
    knows_retarder: bool = True
