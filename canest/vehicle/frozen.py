"""Signals that stand still while the vehicle does not: a sensor or a controller that repeats itself.

What is the same to the last bit, again and again, while another signal shows that the vehicle has become
faster or slower, is no measurement any more. It is taken as silent until it moves again, and with it all that
comes in the same message. Silence is a fault that everything behind here can take.

Watched are the speed in use and the engine's, whose message brings the torque, by the other speeds; and the
accelerometer, by what is quicker in the speed than any road. What else freezes closes the gate `implausible`.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise

import numpy as np

from canest.columns import shifted
from canest.config.schema import Config
from canest.frames import BoolColumn, FloatColumn, IntColumn
from canest.grid.grid import GridBlock
from canest.roles import LASTING, ROLES
from canest.vehicle.samples import RATE_HZ, STEP_US
from canest.vehicle.screen import MAX_ACCEL_MPS2, SPEED_ORDER, SPEED_SLACK_MPS
from canest.vehicle.sources import speed_in_use

#: another speed must have changed by so much: more than noise and rounding to a mile per hour, m/s
MOVED_MPS = 0.6
#: what it shows before is not counted: it may be late, s
SETTLED_S = 0.5
#: the grid holds a value as long as it may age; one that stands for so many times that is repeated
REPEATED = 3.0
#: who says 0 may feel no motion yet, as sensors of pulses do up to some km/h: so many times `MOVED_MPS`
AT_REST = 3.0
#: an acceleration is the mean over so many ticks, and is compared with that of so many before
MEAN_TICKS, APART_TICKS = 25, 50
#: no road changes it by more meanwhile, m/s2: engines and brakes do
QUICK_MPS2 = 0.5
#: too late, or not tied to the road
_NO_WITNESS = ("engine_speed", "gps_speed")
_ACCELEROMETER = "longitudinal_accel"
#: name under which ticks say that a speed is frozen
STOOD = "frozen_speed"


class _Still:
    """One signal: since when it stands, and how long it must."""

    def __init__(self, config: Config, role: str, settled_ticks: float) -> None:
        signals = config.signals
        stale_s = signals[role].stale_s
        stale_s = ROLES[role].stale_s if stale_s is None else stale_s
        self.role, self._settled_ticks = role, settled_ticks
        self._least_ticks = max(SETTLED_S, REPEATED * stale_s) * RATE_HZ
        #: all that comes in the same message, itself included
        self.mates = [other for other in signals if other not in LASTING and _together(config, role, other)]
        self._value, self._since_tick = math.nan, 0

    def refuted(self, ticks: GridBlock, tick: IntColumn) -> BoolColumn | None:
        """Return where the signal is frozen (n,), None where it is not; remember what has been seen."""
        values = ticks.values[self.role]
        same = values == shifted(values, self._value)
        if not ticks.continues:
            same[0] = False
        self._value = float(values[-1])
        if not np.count_nonzero(same):
            self._since_tick = int(tick[-1])
            self._shows(ticks, values, same)
            return None
        began = np.maximum.accumulate(np.where(same, self._since_tick if same[0] else tick[0], tick))
        self._since_tick = int(began[-1])
        found = self._shows(ticks, values, same & (tick - began >= self._settled_ticks))
        found &= tick - began >= self._least_ticks
        return found if np.count_nonzero(found) else None

    def _shows(self, ticks: GridBlock, values: FloatColumn, settled: BoolColumn) -> BoolColumn:
        """Return where others have shown motion since the signal has settled (n,)."""
        found = np.zeros(len(values), np.bool_)
        if not settled[-1] and not np.count_nonzero(settled):
            self._forget()
            return found
        edges = np.flatnonzero(settled[1:] != settled[:-1]) + 1
        for begin, end in pairwise([0, *edges.tolist(), len(values)]):
            if settled[begin]:
                found[begin:end] = self._shown(ticks, float(values[begin]), slice(begin, end))
            else:
                self._forget()
        return found

    def _forget(self) -> None:
        """It moves: what others have shown before is void."""
        raise NotImplementedError

    def _shown(self, ticks: GridBlock, value: float, part: slice) -> BoolColumn:
        """Return where others have shown motion so far while it stood at a value."""
        raise NotImplementedError


class _Speed(_Still):
    """A speed, while others change."""

    def __init__(self, config: Config, role: str) -> None:
        super().__init__(config, role, SETTLED_S * RATE_HZ)
        roles = (r for r in SPEED_ORDER if r in config.signals and r not in _NO_WITNESS)
        self.witnesses = {r: _metres(config, r) for r in roles if r not in self.mates}
        self._ranges: dict[str, _Range] = {}

    def _forget(self) -> None:
        self._ranges.clear()

    def _shown(self, ticks: GridBlock, value: float, part: slice) -> BoolColumn:
        slack = MOVED_MPS * (1.0 if value else AT_REST)
        found = np.zeros(part.stop - part.start, np.bool_)
        if not value and self.role == "undriven_speed":  # driven wheels spin, and the vehicle stands
            return found
        for role, scale in self.witnesses.items():
            moved = self._ranges.setdefault(role, _Range()).push(scale * ticks.values[role][part])
            found |= moved > slack
        return found


class _Range:
    """How far a speed has moved, m/s; one that jumps shows no motion and begins anew."""

    def __init__(self) -> None:
        self._least, self._largest, self._last = math.inf, -math.inf, math.nan

    def push(self, speed: FloatColumn) -> FloatColumn:
        """Return over which range it has moved so far (n,)."""
        moved = np.empty(len(speed))
        jumps = np.abs(speed - shifted(speed, self._last)) > SPEED_SLACK_MPS
        for i, (begin, end) in enumerate(pairwise([0, *np.flatnonzero(jumps).tolist(), len(speed)])):
            if i:
                self._least, self._largest = math.inf, -math.inf
            if end > begin:
                low = np.fmin(np.fmin.accumulate(speed[begin:end]), self._least)
                high = np.fmax(np.fmax.accumulate(speed[begin:end]), self._largest)
                moved[begin:end] = high - low
                self._least, self._largest = float(low[-1]), float(high[-1])
        self._last = float(speed[-1])
        return moved


class _Felt(_Still):
    """The accelerometer, while the speed in use changes quickly."""

    def __init__(self, config: Config, speed: str) -> None:
        super().__init__(config, _ACCELEROMETER, MEAN_TICKS + APART_TICKS)
        self._speed, self._scale = speed, _metres(config, speed)
        self._past = np.full(MEAN_TICKS + APART_TICKS, np.nan)
        self._changes = np.empty(0)
        self._quickest = 0.0

    def refuted(self, ticks: GridBlock, tick: IntColumn) -> BoolColumn | None:
        """As of any signal; the changes of acceleration are noted first."""
        if not ticks.continues:
            self._past[:] = np.nan
        speed = np.concatenate((self._past, self._scale * ticks.values[self._speed]))
        self._past = speed[len(ticks) :]
        mean = (speed[MEAN_TICKS:] - speed[:-MEAN_TICKS]) * (RATE_HZ / MEAN_TICKS)
        changes = np.abs(mean[APART_TICKS:] - mean[:-APART_TICKS])
        self._changes = np.where(changes <= MAX_ACCEL_MPS2, changes, 0.0)  # beyond it is damage
        return super().refuted(ticks, tick)

    def _forget(self) -> None:
        self._quickest = 0.0

    def _shown(self, ticks: GridBlock, value: float, part: slice) -> BoolColumn:
        quickest = np.fmax.accumulate(np.fmax(self._changes[part], self._quickest))
        self._quickest = float(quickest[-1])
        return np.asarray(quickest > QUICK_MPS2)


class Frozen:
    """Watches the signals of a config; counts the ticks on which one was frozen, per role."""

    def __init__(self, config: Config) -> None:
        self.counts: Counter[str] = Counter()
        speed = speed_in_use(config) or "engine_speed"
        watched = (role for role in dict.fromkeys((speed, "engine_speed")) if role in config.signals)
        self._watched: list[_Still] = [s for role in watched if (s := _Speed(config, role)).witnesses]
        if _ACCELEROMETER in config.signals and speed not in _NO_WITNESS:
            self._watched.append(_Felt(config, speed))

    def silence(self, ticks: GridBlock) -> GridBlock:
        """Return the ticks with what is frozen as stale."""
        tick = ticks.t_us // STEP_US
        silent: dict[str, BoolColumn] = {}
        stood = np.zeros(len(ticks), np.bool_)
        for still in self._watched:
            refuted = still.refuted(ticks, tick)
            if refuted is not None:
                self.counts[still.role] += int(np.count_nonzero(refuted))
                silent |= {mate: refuted | silent.get(mate, False) for mate in still.mates}
                stood |= refuted & isinstance(still, _Speed)
        if not silent:
            return ticks
        values = {role: np.where(where, np.nan, ticks.values[role]) for role, where in silent.items()}
        stale = {role: ticks.stale[role] | where for role, where in silent.items()}
        # until it was noticed it was believed: nothing is learned on top of that
        values[STOOD] = stood.astype(np.float64)
        return replace(ticks, values={**ticks.values, **values}, stale={**ticks.stale, **stale})


def _metres(config: Config, role: str) -> float:
    """Return m/s per unit of a role that tells a speed."""
    vehicle = config.vehicle
    return (
        math.pi / 30 / vehicle.final_drive * vehicle.wheel_radius_m if role == "output_shaft_speed" else 1.0
    )


def _together(config: Config, role: str, other: str) -> bool:
    """Return whether two roles come in one message of one sender."""
    a, b = config.signals[role], config.signals[other]
    return role == other or (a.message is not None and (a.message, a.source) == (b.message, b.source))
