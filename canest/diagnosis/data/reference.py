"""What the residual is measured against: the best mass and grade that a drive offers.

In order of preference: known grade (truth), a slope sensor, altitude and accelerometer together (altitude
knows the long waves, the accelerometer the short ones; its bias and the body's pitch are estimated), and
nothing, when the grade is only known to be a slow function of distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from canest.core.columns import shifted
from canest.core.errors import LogError
from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.drive import Drive, Run
from canest.diagnosis.data.road_smoother import (
    ACCELEROMETER_STD_MPS2,
    BIAS_STD_MPS2,
    PITCH_STD,
    STEP_TICKS,
    altitude_noise_m,
    on_ticks,
    pitch_std_of,
    smooth,
    whole_seconds,
)
from canest.logs.memory import MemoryLog
from canest.logs.truth import read_truth
from canest.offline.scoring import Score

#: how fast a road's slope may wander, per root metre: from motorway (0.1 % over 100 m) to short, steep hills
#: (3.2 %); the likeliest for the drive is taken. What a road may not do is put down to the body's pitch
GRADE_WALKS_PER_SQRT_M = (0.0001, 0.0002, 0.0004, 0.0008, 0.0016, 0.0032)
#: share of the body's pitch that no factor on the acceleration describes
PITCH_SHARE = 0.1


@dataclass(frozen=True)
class Reference:
    """Mass and grade of one drive on its ticks.

    mass_kg (n,) or None when unknown; NaN where the truth has none, as in grade. sin_beta (n,),
    already passed through the model's filter, and sin_beta_std (scalar): 0 where it is known, large where
    it is not observed; correlation_m: distance over which its error keeps its value. kind: a name for the
    report. notes: what was wrong with the truth's table.
    """

    kind: str
    text: str
    mass_kg: FloatColumn | None
    sin_beta: FloatColumn
    sin_beta_std: float
    correlation_m: float = 300.0
    grade: FloatColumn | None = None  #: unfiltered truth, for scoring
    #: what the accelerometer's bias (m/s2) and the body's pitch (rad per m/s2) may still be off by
    bias_std_mps2: float = 0.0
    pitch_std: float = 0.0
    notes: tuple[str, ...] = ()


def reference_for(
    drive: Drive, run: Run, *, truth: Path | MemoryLog | None = None, mass_kg: float | None = None
) -> Reference:
    """Return the best reference: truth file, then --mass with the bus' own sensors, then the bus alone.

    Errors: LogError for a truth file that is none, or is of another time than the drive.
    """
    n = len(run.samples)
    mass = None if mass_kg is None else np.full(n, float(mass_kg))
    notes: tuple[str, ...] = ()
    if truth is not None:
        shown_us = run.samples.t_us - round(run.behind_s * 1e6)
        known = read_truth(truth)
        notes = known.notes
        true_mass, grade = Score(known).truth_at(shown_us)
        has_mass, has_grade = np.isfinite(true_mass).any(), np.isfinite(grade).any()
        if not (has_grade or has_mass):
            begin, end = run.samples.t_us[[0, -1]] * 1e-6
            of_drive = f"mass_kg or grade between t_s {begin:.0f} and {end:.0f}"
            raise LogError("does not overlap the drive in time", where=str(truth), expected=of_drive)
        if mass is None and has_mass:
            mass = true_mass
        if has_grade:
            sin_beta = drive.filtered(np.sin(np.arctan(filled(grade))), run)
            return Reference("truth", "known grade", mass, sin_beta, 0.0, grade=grade, notes=notes)
    sensed = _slope_sensor(drive, run) or _altitude_and_accelerometer(drive, run)
    if sensed is not None:
        return replace(sensed, mass_kg=mass, notes=notes)
    text = "nothing but the bus: the grade is only known to change slowly with distance"
    return Reference("none", text, mass, np.zeros(n), 0.03, notes=notes)


def filled(column: FloatColumn) -> FloatColumn:
    """Return a column (n,) of which some is known, with numbers between and beside what is known."""
    known = np.flatnonzero(np.isfinite(column))
    return np.interp(np.arange(len(column)), known, column[known])


def _slope_sensor(drive: Drive, run: Run) -> Reference | None:
    slope = run.samples.slope
    known = np.isfinite(slope)
    if known.mean() < 0.9:
        return None
    sin_beta = np.sin(np.arctan(np.interp(run.t_s, run.t_s[known], slope[known])))
    return Reference("slope", "slope sensor", None, drive.filtered(sin_beta, run), 0.002, 100.0)


def _altitude_and_accelerometer(drive: Drive, run: Run) -> Reference | None:
    """Return the smoothed road (`road_smoother`), of the roughness that is the likeliest."""
    m = run.samples
    first, fresh = whole_seconds(run.begins)
    has_altitude = np.isfinite(m.altitude_m).mean() > 0.5
    has_accelerometer = np.isfinite(m.accelerometer_mps2).mean() > 0.5
    if len(first) < 20 or not (has_altitude or has_accelerometer):
        return None
    ticks = first[:, None] + np.arange(STEP_TICKS)

    def mean(x: FloatColumn) -> FloatColumn:
        return np.asarray(np.mean(x[ticks], axis=1))

    speed = mean(np.where(np.isfinite(m.speed_mps), m.speed_mps, 0.0))
    driving = speed > 1.0
    if not driving.any():
        return None  # no road was passed that could be smoothed
    accel = mean(m.accel_mps2)
    extra = mean(m.accelerometer_mps2) - accel
    altitude = m.altitude_m[ticks[:, -1]]
    # one that stands still is held from report to report, or stuck: the same again is no measurement
    altitude = np.where(altitude == shifted(altitude, math.nan), math.nan, altitude)
    noise = altitude_noise_m(altitude, speed)
    pitch = drive.config.vehicle.accelerometer.pitch_rad_per_mps2
    moving = np.maximum(speed, 0.1)
    smoothed = [
        (smooth(fresh, speed, accel, extra, altitude, noise, walk**2 * moving, pitch), walk)
        for walk in GRADE_WALKS_PER_SQRT_M
    ]
    road, walk = max(smoothed, key=lambda s: s[0].log_likelihood)
    std = road.std
    # the smoother averages the sharper sensor over the distance in which the road changes as much as it errs
    sensor = ACCELEROMETER_STD_MPS2 / GRAVITY_MPS2 if has_accelerometer else noise / 20.0
    correlation_m = float(np.clip(np.median(moving[driving] ** 0.5) * sensor / walk, 10.0, 500.0))
    column = on_ticks(road.sin_beta, first, fresh, len(m))
    names = [n for n, has in (("altitude", has_altitude), ("accelerometer", has_accelerometer)) if has]
    text = "grade from " + " and ".join(names) + ", smoothed over the drive"
    if not has_altitude:
        std = float(np.hypot(std, 0.5 * BIAS_STD_MPS2 / GRAVITY_MPS2))
    # a body pitches with a lag and by its load: never in proportion to better than this
    least_std = PITCH_SHARE * (PITCH_STD if pitch is None else max(pitch, 0.003))
    pitch_std = max(road.pitch_std, least_std) if has_accelerometer else 0.0
    if has_accelerometer and not has_altitude:
        # a driver who slows uphill makes slope and acceleration alike: a drive alone does not part them
        pitch_std = pitch_std_of(pitch)
    # the bias is a steady error only where an altitude ties it down: else it is free, see `Problem`
    bias_std = road.bias_std_mps2 if has_accelerometer and has_altitude else 0.0
    kind = "+".join(names)
    return Reference(
        kind, text, None, column, std, correlation_m, bias_std_mps2=bias_std, pitch_std=pitch_std
    )
