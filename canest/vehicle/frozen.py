"""An accelerometer that stands still while the vehicle does not: a sensor that repeats itself.

What is the same to the last bit, again and again, while the speed shows that brakes or engine have acted, is
no measurement any more. It is taken as silent until it moves again, and with it all that comes in the same
message. Silence is a fault that everything behind here can take. What else freezes closes the gate
`implausible` or `driveline`.
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
from canest.vehicle.screen import MAX_ACCEL_MPS2
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
        self._watched: list[_Still] = []
        if _ACCELEROMETER in config.signals and speed not in _NO_WITNESS:
            self._watched.append(_Felt(config, speed))

    def silence(self, ticks: GridBlock) -> GridBlock:
        """Return the ticks with what is frozen as stale."""
        tick = ticks.t_us // STEP_US
        silent: dict[str, BoolColumn] = {}
        for still in self._watched:
            refuted = still.refuted(ticks, tick)
            if refuted is not None:
                self.counts[still.role] += int(np.count_nonzero(refuted))
                silent |= {mate: refuted | silent.get(mate, False) for mate in still.mates}
        if not silent:
            return ticks
        values = {role: np.where(where, np.nan, ticks.values[role]) for role, where in silent.items()}
        stale = {role: ticks.stale[role] | where for role, where in silent.items()}
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
