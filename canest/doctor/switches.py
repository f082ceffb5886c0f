"""Do the switches of brake and clutch fit what the vehicle does? None can pull with its driveline open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from canest.core.frames import BoolColumn, FloatColumn, IntColumn
from canest.doctor.stretches import Samples, at, held
from canest.vehicle.driveline_state import CLUTCH_ROLES, ENGAGED_ROLES

if TYPE_CHECKING:
    from canest.config import Config

#: finest first; the engine's own speed means nothing while the clutch is open
SPEEDS = ("output_shaft_speed", "undriven_speed", "vehicle_speed", "gps_speed")
TORQUES = ("engine_torque_pct", "engine_torque", "wheel_torque", "wheel_force", "power")
BRAKING = ("brake_switch", "brake_pedal", "parking_brake")
#: signals are compared every 0.1 s, accelerations over 1 s
_STEP_US, _HALF_US, _STEP_S = 100_000, 500_000, 0.1
#: of one stretch at most so long is compared: stamps may leap, and a table may come in one block
_LONGEST_US = 20_000_000_000
#: a vehicle pulls that gets faster by more than this (m/s2) while its torque is above this share; without a
#: torque, by more than on any slope that it may roll down
_PULLS_MPS2, _PULLS_SHARE, _ROLLS_MPS2 = 0.3, 0.25, 1.0
#: an open driveline may carry over a little of a shift: fewer seconds, or a smaller share, prove nothing
_LEAST_S, _SHARE, _ALWAYS = 3.0, 0.5, 0.99
#: slower it stands; the engine runs above, rpm
_STANDS_MPS, _RUNS_RPM = 0.2, 400.0
#: a clutch must have opened when it has stood for so long in gear, or shifted so often
_STOOD_S, _SHIFTS = 5.0, 10


class SwitchCheck:
    """Streams samples; memory does not grow with the log."""

    def __init__(self, config: Config) -> None:
        self._config = config
        mapped = config.signals
        self._clutches = [] if config.vehicle.has_one_gear else [r for r in CLUTCH_ROLES if r in mapped]
        opens = [r for r in ("driveline_engaged", "clutch_switch") if r in self._clutches]
        self._watched = [*opens, *(r for r in BRAKING if r in mapped)]
        self._known_s = dict.fromkeys(self._watched, 0.0)
        self._on_s = dict.fromkeys(self._watched, 0.0)
        self._pulled_s = dict.fromkeys(self._watched, 0.0)
        self._pulled_on_s = dict.fromkeys(self._watched, 0.0)
        self._most_torque = config.vehicle.reference_torque_Nm or 1.0
        self._opened, self._reported = False, set[str]()
        self._stood_s, self._shifts = 0.0, 0

    def push(self, stretch: Samples) -> None:
        """Take the samples of a stretch."""
        speed = next((role for role in SPEEDS if role in stretch), None)
        if speed is None:
            return
        first, last = int(stretch[speed][0].min()), int(stretch[speed][0].max())
        stamps = np.arange(first, min(last, first + _LONGEST_US), _STEP_US, dtype=np.int64)
        factor = self._config.vehicle.mps_per_shaft_rpm if speed == "output_shaft_speed" else 1.0
        mps = at(stamps, stretch[speed]) * factor
        if self._clutches:
            self._note_clutch(stamps, mps, stretch)
        pulls = self._pulls(stamps, mps, at(stamps + _HALF_US, stretch[speed]) * factor, stretch)
        for role in self._watched:
            if role not in stretch:
                continue
            state = held(stamps, stretch[role])
            known, on = np.isfinite(state), self._is_on(role, state)
            self._known_s[role] += _STEP_S * np.count_nonzero(known)
            self._on_s[role] += _STEP_S * np.count_nonzero(on)
            self._pulled_s[role] += _STEP_S * np.count_nonzero(pulls & known)
            self._pulled_on_s[role] += _STEP_S * np.count_nonzero(pulls & on)

    def hints(self) -> list[str]:
        """Return which switches cannot be right, one sentence each."""
        return [*(h for role in self._watched if (h := self._pulls_with(role))), *self._never_open()]

    def _is_on(self, role: str, state: FloatColumn) -> BoolColumn:
        """Return where a brake is on, or a clutch open (n,)."""
        if role in ENGAGED_ROLES:
            return np.asarray(state < 0.5)
        if role == "clutch_slip":
            return np.asarray(state > self._config.gates.driveline.clutch_slip_pct)
        if role == "brake_pedal":
            return np.asarray(state > self._config.gates.brake.pedal_pct)
        return np.asarray(state > 0.5)

    def _pulls(
        self, stamps: IntColumn, mps: FloatColumn, later_mps: FloatColumn, stretch: Samples
    ) -> BoolColumn:
        """Return where the vehicle gets faster by its own torque (n,)."""
        accel = (later_mps - mps) * (1e6 / _HALF_US)
        torque = next((role for role in TORQUES if role in stretch), None)
        if torque is None:
            return np.asarray(accel > _ROLLS_MPS2)
        found = at(stamps, stretch[torque])
        if torque == "engine_torque_pct":
            share = found / 100.0
        else:
            self._most_torque = max(self._most_torque, float(np.nanmax(found, initial=0.0)))
            share = found / self._most_torque
        return np.asarray((accel > _PULLS_MPS2) & (share > _PULLS_SHARE))

    def _note_clutch(self, stamps: IntColumn, mps: FloatColumn, stretch: Samples) -> None:
        for role in self._clutches:
            if role in stretch and np.isfinite(stretch[role][1]).any():
                self._reported.add(role)
                self._opened |= bool(self._is_on(role, stretch[role][1]).any())
        if "gear" not in stretch or "engine_speed" not in stretch:
            return
        gear = held(stamps, stretch["gear"])
        geared = (gear > 0) & (gear < 100)
        runs = at(stamps, stretch["engine_speed"]) > _RUNS_RPM
        self._stood_s += _STEP_S * np.count_nonzero(geared & runs & (mps < _STANDS_MPS))
        self._shifts += int(np.count_nonzero(geared[1:] & geared[:-1] & (np.diff(gear) != 0)))

    def _pulls_with(self, role: str) -> str:
        """Return that a vehicle pulls with its brake on or its clutch open, '' where it does not."""
        pulled_s, on_s = self._pulled_s[role], self._pulled_on_s[role]
        if on_s < _LEAST_S or on_s < _SHARE * pulled_s:
            return ""
        states = {"driveline_engaged": "is open", "clutch_switch": "is pressed"}
        found = (
            f"{role} {states.get(role, 'is on')} in {on_s:,.0f} of {pulled_s:,.0f} s in which the vehicle "
            "pulls"
        )
        if self._on_s[role] >= _ALWAYS * self._known_s[role]:
            return f"{found}, as it does all the time: stuck, inverted or another signal? (signals.{role})"
        if role == "brake_pedal":
            return f"{found}: does it rest above gates.brake.pedal_pct?"
        inverted = str(not self._config.signals[role].invert).lower()
        return f"{found}: is it inverted? Then signals.{role} needs invert: {inverted}"

    def _never_open(self) -> list[str]:
        if not self._reported or self._opened or (self._stood_s < _STOOD_S and self._shifts < _SHIFTS):
            return []
        did = f"stood {self._stood_s:.0f} s in gear with its engine running, and shifted {self._shifts} times"
        return [
            f"{' and '.join(sorted(self._reported))} never reported an open clutch, though the vehicle "
            f"{did}: is it the right signal?"
        ]
