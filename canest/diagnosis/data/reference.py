"""What the residual is measured against: the best mass and grade that a drive offers.

In order of preference: known grade (truth), a slope sensor, altitude and accelerometer together (altitude
knows the long waves, the accelerometer the short ones; its bias and the body's pitch are estimated), and
nothing, when the grade is only known to be a slow function of distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ
from canest.diagnosis.data.drive import Drive, Run
from canest.logs.memory import MemoryLog
from canest.logs.truth import read_truth
from canest.offline.scoring import Score

#: how fast a road's slope may wander, per root metre: from motorway to hills (0.1 to 0.8 % over 100 m);
#: the likeliest for the drive is taken
GRADE_WALKS_PER_SQRT_M = (0.0001, 0.0002, 0.0004, 0.0008)
#: noise of a navigation receiver's altitude, m, when its own scatter does not say
MIN_ALTITUDE_STD_M = 0.3
#: an accelerometer's share of vibration that is left in one second, m/s2
ACCELEROMETER_STD_MPS2 = 0.04
#: bias of a vehicle's accelerometer, m/s2, and body pitch, rad per m/s2: prior spread
BIAS_STD_MPS2, PITCH_STD = 0.3, 0.01
#: what is not known of a road: how high it lies, m, and how steep it is
_ALTITUDE_STD_M, _SLOPE_STD = 100.0, 0.05
_STEP = round(RATE_HZ)  #: ticks per smoother step: one second


@dataclass(frozen=True)
class Reference:
    """Mass and grade of one drive on its ticks.

    mass_kg (n,) or None when unknown; NaN where the truth does not tell it, as in grade. sin_beta (n,),
    already passed through the model's filter, and sin_beta_std (scalar): 0 where it is known, large where
    nothing tells it; correlation_m: distance over which its error keeps its value. kind: a name for the
    report.
    """

    kind: str
    text: str
    mass_kg: FloatColumn | None
    sin_beta: FloatColumn
    sin_beta_std: float
    correlation_m: float = 300.0
    grade: FloatColumn | None = None  #: unfiltered truth, for scoring


def reference_for(
    drive: Drive, run: Run, *, truth: Path | MemoryLog | None = None, mass_kg: float | None = None
) -> Reference:
    """Return the best reference: truth file, then --mass with the bus' own sensors, then the bus alone.

    Errors: LogError for a truth file that is none, or is of another time than the drive.
    """
    n = len(run.samples)
    mass = None if mass_kg is None else np.full(n, float(mass_kg))
    if truth is not None:
        shown_us = run.samples.t_us - round(run.behind_s * 1e6)
        true_mass, grade = Score(read_truth(truth)).truth_at(shown_us)
        has_mass, has_grade = np.isfinite(true_mass).any(), np.isfinite(grade).any()
        if not (has_grade or has_mass):
            begin, end = run.samples.t_us[[0, -1]] * 1e-6
            of_drive = f"mass_kg or grade between t_s {begin:.0f} and {end:.0f}"
            raise LogError("tells nothing of the drive", where=str(truth), expected=of_drive)
        if mass is None and has_mass:
            mass = true_mass
        if has_grade:
            sin_beta = drive.filtered(np.sin(np.arctan(filled(grade))), run)
            return Reference("truth", "known grade", mass, sin_beta, 0.0, grade=grade)
    sensed = _slope_sensor(drive, run) or _altitude_and_accelerometer(drive, run)
    if sensed is not None:
        kind, text, sin_beta, std, correlation_m = sensed
        return Reference(kind, text, mass, sin_beta, std, correlation_m)
    text = "nothing but the bus: the grade is only known to change slowly with distance"
    return Reference("none", text, mass, np.zeros(n), 0.03)


def filled(column: FloatColumn) -> FloatColumn:
    """Return a column (n,) of which some is known, with numbers between and beside what is known."""
    known = np.flatnonzero(np.isfinite(column))
    return np.interp(np.arange(len(column)), known, column[known])


#: kind, text, sin(beta) per tick, its standard deviation, correlation length of its error in m
_Sensed = tuple[str, str, FloatColumn, float, float]


def _slope_sensor(drive: Drive, run: Run) -> _Sensed | None:
    slope = run.samples.slope
    known = np.isfinite(slope)
    if known.mean() < 0.9:
        return None
    sin_beta = np.sin(np.arctan(np.interp(run.t_s, run.t_s[known], slope[known])))
    return "slope", "slope sensor", drive.filtered(sin_beta, run), 0.002, 100.0


def _altitude_and_accelerometer(drive: Drive, run: Run) -> _Sensed | None:
    """Smooth [altitude, sin(beta), accelerometer bias, pitch] over the drive (Kalman filter, RTS smoother).

    altitude_k+1 = altitude_k + v dt sin(beta);  sin(beta) a random walk in distance;
    accelerometer = a + g sin(beta) + bias + g pitch a   (2014 paper, eq. 3, with its pitch correction).
    """
    m = run.samples
    first, fresh = _seconds(run.begins)
    has_altitude = np.isfinite(m.altitude_m).mean() > 0.5
    has_accelerometer = np.isfinite(m.accelerometer_mps2).mean() > 0.5
    if len(first) < 20 or not (has_altitude or has_accelerometer):
        return None
    ticks = first[:, None] + np.arange(_STEP)

    def mean(x: FloatColumn) -> FloatColumn:
        return np.asarray(np.mean(x[ticks], axis=1))

    speed = mean(np.where(np.isfinite(m.speed_mps), m.speed_mps, 0.0))
    driving = speed > 1.0
    if not driving.any():
        return None  # no road was passed that could be smoothed
    accel = mean(m.accel_mps2)
    extra = mean(m.accelerometer_mps2) - accel
    altitude = m.altitude_m[ticks[:, -1]]
    noise = _altitude_noise(altitude, speed)
    pitch = drive.config.vehicle.accelerometer.pitch_rad_per_mps2
    moving = np.maximum(speed, 0.1)
    smoothed = [
        (*_smooth(fresh, speed, accel, extra, altitude, noise, walk**2 * moving, pitch), walk)
        for walk in GRADE_WALKS_PER_SQRT_M
    ]
    _, sin_beta, std, walk = max(smoothed, key=lambda s: s[0])
    # the smoother averages the sharper sensor over the distance in which the road changes as much as it errs
    sensor = ACCELEROMETER_STD_MPS2 / GRAVITY_MPS2 if has_accelerometer else noise / 20.0
    correlation_m = float(np.clip(np.median(moving[driving] ** 0.5) * sensor / walk, 10.0, 500.0))
    column = _on_ticks(sin_beta, first, fresh, len(m))
    names = [n for n, has in (("altitude", has_altitude), ("accelerometer", has_accelerometer)) if has]
    text = "grade from " + " and ".join(names) + ", smoothed over the drive"
    if not has_altitude:
        std = float(np.hypot(std, 0.5 * BIAS_STD_MPS2 / GRAVITY_MPS2))
    return "+".join(names), text, column, std, correlation_m


def _seconds(begins: BoolColumn) -> tuple[IntColumn, BoolColumn]:
    """Return the first tick of each whole second (k,), and which of them follow another across a gap.

    begins: where the log begins, or goes on after a gap (n,).
    """
    edges = np.flatnonzero(begins)
    bounds = pairwise([*edges.tolist(), len(begins)])
    first = np.concatenate([np.arange(a, b - _STEP + 1, _STEP) for a, b in bounds])
    fresh = np.isin(first, edges)
    fresh[:1] = False  # what lies before it was too short for a second
    return first, fresh


def _on_ticks(values: FloatColumn, first: IntColumn, fresh: BoolColumn, n: int) -> FloatColumn:
    """Return what was found for each second on every tick (n,), drawn through no gap."""
    ticks, centres = np.arange(n), first + 0.5 * (_STEP - 1)
    column = np.empty(n)
    edges = np.flatnonzero(fresh).tolist()
    starts = [0, *first[edges].tolist(), n]
    for (begin, end), (a, b) in zip(pairwise([0, *edges, len(first)]), pairwise(starts), strict=True):
        column[a:b] = np.interp(ticks[a:b], centres[begin:end], values[begin:end])
    return column


def _altitude_noise(altitude: FloatColumn, speed: FloatColumn) -> float:
    """Return the altitude's noise from its second differences (a road has none at one second)."""
    moving = altitude[(speed > 1.0) & np.isfinite(altitude)]
    if len(moving) < 10:
        return 10.0
    second = np.diff(moving, 2)
    return max(float(1.4826 * np.median(np.abs(second)) / np.sqrt(6.0)), MIN_ALTITUDE_STD_M)


def _smooth(
    fresh: BoolColumn,
    speed: FloatColumn,
    accel: FloatColumn,
    extra: FloatColumn,
    altitude: FloatColumn,
    altitude_std: float,
    walk: FloatColumn,
    pitch: float | None,
) -> tuple[float, FloatColumn, float]:
    """Return log likelihood, sin(beta) (k,) and its median standard deviation; one step is one second.

    fresh: steps after a gap: nobody knows where the road has led.
    """
    n = len(speed)
    known = altitude[np.isfinite(altitude)]
    x = np.array([known[0] if len(known) else 0.0, 0.0, 0.0, 0.01 if pitch is None else pitch])
    pitch_std = PITCH_STD if pitch is None else 0.3 * max(pitch, 0.003)
    P = np.diag([_ALTITUDE_STD_M**2, _SLOPE_STD**2, BIAS_STD_MPS2**2, pitch_std**2])
    xs, Ps = np.empty((n, 4)), np.empty((n, 4, 4))
    before_x, before_P, Fs = np.empty((n, 4)), np.empty((n, 4, 4)), np.empty((n, 4, 4))
    likelihood = 0.0
    for k in range(n):
        F = np.eye(4)
        F[0, 1] = 0.0 if fresh[k] else speed[k]
        x, P = F @ x, F @ P @ F.T
        if fresh[k]:
            P[0, 0] += _ALTITUDE_STD_M**2
            P[1, 1] += _SLOPE_STD**2
        P[1, 1] += walk[k]
        P[0, 0] += 0.01
        before_x[k], before_P[k], Fs[k] = x, P, F
        if np.isfinite(altitude[k]):
            x, P, ll = _update(x, P, np.array([1.0, 0, 0, 0]), altitude[k], altitude_std**2)
            likelihood += ll
        if np.isfinite(extra[k]):
            h = np.array([0, GRAVITY_MPS2, 1.0, GRAVITY_MPS2 * accel[k]])
            x, P, ll = _update(x, P, h, extra[k], ACCELEROMETER_STD_MPS2**2 + (0.05 * accel[k]) ** 2)
            likelihood += ll
        xs[k], Ps[k] = x, P
    for k in range(n - 2, -1, -1):
        C = Ps[k] @ Fs[k + 1].T @ np.linalg.inv(before_P[k + 1])
        xs[k] += C @ (xs[k + 1] - before_x[k + 1])
        Ps[k] += C @ (Ps[k + 1] - before_P[k + 1]) @ C.T
    return likelihood, xs[:, 1], float(np.sqrt(np.median(Ps[:, 1, 1])))


def _update(
    x: FloatColumn, P: FloatColumn, h: FloatColumn, y: float, r: float
) -> tuple[FloatColumn, FloatColumn, float]:
    """Take one scalar measurement y = h x + noise of variance r (Joseph form); also its log likelihood."""
    s = float(h @ P @ h) + r
    K = P @ h / s
    A = np.eye(len(x)) - np.outer(K, h)
    innovation = float(y - h @ x)
    return (
        x + K * innovation,
        A @ P @ A.T + r * np.outer(K, K),
        -0.5 * (innovation**2 / s + float(np.log(s))),
    )
