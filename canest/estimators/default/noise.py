"""Noise: the force that the model lacks, and levels that follow innovations (docs/theory.md, section 6)."""

from __future__ import annotations

import math
from typing import NamedTuple

from canest.core import jit
from canest.core.samples import STEP_S
from canest.estimators.default.constants import Constants, Vehicle
from canest.estimators.default.model import Window
from canest.estimators.windowing import WINDOW_S

_STEP_STD = math.sqrt(12.0)
#: mean NIS above which the model does not explain what happens; a consistent filter's is 1
_INCONSISTENT = 1.8
#: and below which it does again: what was learned meanwhile has to be learned anew
_CONSISTENT = 1.6
#: first level of an accelerometer at least, m/s2: one that is finer than its noise must not fix the bias
_FIRST_SENSED_MPS2 = 0.1
#: one window counts as that many gross ones at most
_MOST_GROSS = 4.0
#: what is left of the low-passed innovation a window later: a time constant of 0.6 s
_LEFT = 0.7


class Levels(NamedTuple):
    """Noise levels, and how well the innovations agree with them."""

    speed_var: float  #: variance of a speed, (m/s)2
    sensed_var: float  #: of the accelerometer, (m/s2)2
    windows: float = 0.0  #: open windows so far
    nis_sum: float = 0.0  #: sum of their normalised innovations squared
    torque_Nm2s: float = 0.0  #: density of the noise of the torque
    nis: float = 1.0  #: mean of the last two minutes
    refuted: bool = False  #: while the innovations refute the model
    low: float = 0.0  #: innovations over their std, low-passed: of variance 1 where they are white
    low_nis: float = 1.0  #: mean of its square of the last two minutes


@jit.kernel
def force_noise(w: Window, torque_Nm2s: float, c: Constants, v: Vehicle) -> float:
    """Return the density of the force that the model lacks, N2 s (docs/theory.md, section 6.1).

    A share of the traction; the noise of the torque; its rounding error, which lasts while it stands still;
    and what a slow torque does between two reports, of which only the ends are known.
    """
    step = v.torque_std_Nm * w.gear_1pm
    moved = abs(w.traction_N - w.begin_N)
    lasts_s = min(max(_STEP_STD * step / max(moved, 1.0) * WINDOW_S, WINDOW_S), c.longest_rounding_s)
    lacking = c.force_std_share * w.traction_N
    between = moved * moved * v.period_windows * WINDOW_S / 12.0
    noise = c.torque_noise_times * torque_Nm2s * w.gear_1pm * w.gear_1pm
    return between + lacking * lacking * WINDOW_S + step * step * lasts_s + noise


@jit.kernel
def swing_var(before: float, jump_N: float, w: Window, dt: float, u: float, c: Constants) -> float:
    """Return the variance of a speed by a driveline that swings, (m/s)2 (docs/theory.md, section 6.3).

    before: that of the window before, which dies away. jump_N: change of the traction, which begins a swing.
    """
    if w.rotating_kg <= 0.0 or c.windup_std_s2 <= 0.0:
        return 0.0
    ratio = u * w.rotating_kg
    omega_2 = (1.0 + 1.0 / ratio) / c.windup_std_s2
    step_mps2 = u * jump_N / (1.0 + ratio)
    rise = omega_2 * c.torque_rise_s * c.torque_rise_s
    left = math.exp(-2.0 * c.swing_damping * math.sqrt(omega_2) * dt)
    return left * before + 0.5 * step_mps2 * step_mps2 / (omega_2 * (1.0 + rise) * (1.0 + rise))


@jit.kernel
def first_levels(v: Vehicle) -> Levels:
    """Return the levels with which all begins."""
    sensed = max(2.0 * v.sensed_floor_mps2, _FIRST_SENSED_MPS2)
    return Levels(v.speed_first_mps * v.speed_first_mps, sensed * sensed, 0.0, 0.0, 0.0, 1.0, False, 0.0, 1.0)


@jit.kernel
def unexplained(levels: Levels) -> float:
    """Return by how much all variances are too small: errors that last add up (Newey and West 1987)."""
    return max(levels.low_nis, 1.0)


@jit.kernel
def follow(
    levels: Levels, w: Window, found: tuple[float, float], speed: float, sensed: float, sees: bool,
    c: Constants, v: Vehicle,
) -> Levels:  # fmt: skip
    """Return the levels after an open window.

    found: mean NIS, and the innovation over its standard deviation. speed, sensed: surpluses.
    """
    nis, innovation = found
    windows = levels.windows + 1.0
    memory = min(c.noise_memory_windows, c.first_noise_windows + windows)
    speed_var = max(levels.speed_var + speed / memory, v.speed_floor_mps * v.speed_floor_mps)
    sensed_var = levels.sensed_var
    if sees:
        sensed_var = max(sensed_var + sensed / memory, v.sensed_floor_mps2 * v.sensed_floor_mps2)
    most = c.outlier_nis * max(levels.torque_Nm2s, v.torque_std_Nm * v.torque_std_Nm * STEP_S)
    zigzag = min(max(w.zigzag_Nm2s, -most), most)
    torque_Nm2s = max(levels.torque_Nm2s + (zigzag - levels.torque_Nm2s) / memory, 0.0)
    longer_memory = min(2.0 * c.noise_memory_windows, c.first_noise_windows + windows)
    mean_nis = levels.nis + (min(nis, _MOST_GROSS * c.gross_nis) - levels.nis) / longer_memory
    is_refuted = mean_nis > (_CONSISTENT if levels.refuted else _INCONSISTENT)
    nis_sum, gross = levels.nis_sum + nis, math.sqrt(c.gross_nis)
    low = _LEFT * levels.low + math.sqrt(1.0 - _LEFT * _LEFT) * min(max(innovation, -gross), gross)
    low_nis = levels.low_nis + (low * low - levels.low_nis) / longer_memory
    return Levels(speed_var, sensed_var, windows, nis_sum, torque_Nm2s, mean_nis, is_refuted, low, low_nis)
