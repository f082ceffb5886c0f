"""A brake that is never reported, though the vehicle slows down as only a brake can make it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn
from canest.core.roles import BRAKES
from canest.core.samples import GRAVITY_MPS2
from canest.doctor.missing_signals import RETARDER
from canest.doctor.motion import STEP_S, motion_of
from canest.doctor.stretches import Samples, at
from canest.vehicle.role_sources import torque_role

if TYPE_CHECKING:
    from canest.config import Config

#: beyond drag and rolling resistance, hills do not slow a moving vehicle (m/s) by so much again and again
#: (15 % to climb without a torque), and nothing by more than tyres hold (m/s2)
_MOVES_MPS, _HARD_MPS2, _TYRES_MPS2 = 2.0, 1.5, 10.0
#: a torque that brakes is more negative than this share of the largest; of a retarder, %
_BRAKES_SHARE, _RETARDER_PCT = 0.05, -5.0
#: for at least so many steps at a time (a speed that leaps takes 10), and so often and so long (s) in all
_LEAST_STEPS, _FEWEST, _LEAST_S = 15, 5, 10.0


class SilentBrakeCheck:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._vehicle, roles = config.vehicle, config.signals
        self._least_on = {"brake_switch": 0.5, "brake_pedal": config.gates.brake.pedal_pct}
        asked = not config.gates.brake.assume_when_pedal_released
        self._brakes = [role for role in BRAKES if role in roles and asked]
        self._torque = torque_role(roles, config.vehicle) if self._brakes else ""
        self._reported, self._pressed = set[str](), False
        self._largest, self._times, self._slowed_s = 0.0, 0, 0.0

    def push(self, stretch: Samples) -> None:
        """Take the samples of a stretch."""
        for role in self._brakes:
            if role in stretch:
                values = stretch[role][1]
                if np.isfinite(values).any():
                    self._reported.add(role)
                self._pressed |= bool((values > self._least_on[role]).any())
        if self._brakes and not self._pressed:
            self._compare(stretch)

    def hints(self) -> list[str]:
        """Return that the brake is not reported, at most one sentence."""
        if self._pressed or not self._reported or self._times < _FEWEST or self._slowed_s < _LEAST_S:
            return []
        return [
            f"{' and '.join(sorted(self._reported))} never reported a brake, though the vehicle slowed down "
            f"for {self._slowed_s:,.0f} s much harder than by drag, rolling resistance and its torque: map "
            "the signal of its brake or retarder, or set gates.brake.assume_when_pedal_released: true "
            "(with signals.accelerator), or that force counts as weight or a hill"
        ]

    def _compare(self, stretch: Samples) -> None:
        motion = motion_of(stretch, self._vehicle)
        if motion is None or self._torque not in stretch:
            return
        accel, torque = motion.accel_mps2, at(motion.stamps, stretch[self._torque])
        self._largest = max(self._largest, float(np.nanmax(np.abs(torque), initial=0.0)))
        free = torque > -_BRAKES_SHARE * self._largest
        if RETARDER in stretch:
            free &= ~(at(motion.stamps, stretch[RETARDER]) < _RETARDER_PCT)
        hard = _HARD_MPS2 + self._resistance_mps2(motion.before_mps)
        braked = free & (motion.after_mps > _MOVES_MPS) & (accel < -hard) & (accel > -_TYRES_MPS2)
        runs = _runs(braked)
        runs = runs[runs >= _LEAST_STEPS]
        self._times += len(runs)
        self._slowed_s += STEP_S * float(runs.sum())

    def _resistance_mps2(self, speed_mps: FloatColumn) -> FloatColumn:
        """Return by how much air and road slow the lightest vehicle (n,)."""
        v = self._vehicle
        per_mps = np.sqrt(0.5 * v.air_density_kgpm3 * v.drag_area_m2 / v.mass_min_kg)
        return np.asarray(v.rolling_resistance * GRAVITY_MPS2 + (per_mps * speed_mps) ** 2)


def _runs(found: BoolColumn) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return how many rows follow each other where something is found (k,)."""
    edges = np.diff(np.concatenate(([0], found.astype(np.int8), [0])))
    return np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)
