"""Speeds that stand still while the vehicle does not: a sensor or a controller that repeats itself.

A speed that is the same to the last bit, again and again, while another signal shows that the vehicle has
become faster or slower, is no measurement any more. It is taken as silent until it moves again, and with it
all that comes in the same message. Silence is a fault that everything behind here can take.

Watched are the speed in use and the engine's, whose message brings the torque. What else freezes closes the
gate `implausible`.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from canest.columns import shifted
from canest.config.schema import Config
from canest.frames import BoolColumn, FloatColumn, IntColumn
from canest.grid.grid import GridBlock
from canest.roles import LASTING, ROLES
from canest.vehicle.samples import RATE_HZ, STEP_US
from canest.vehicle.screen import SPEED_ORDER, SPEED_SLACK_MPS

#: another speed must have changed by so much: more than noise and rounding to a mile per hour, m/s
MOVED_MPS = 0.6
#: what it shows before is not counted: it may be late, s
SETTLED_S = 0.5
#: the grid holds a value as long as it may age; one that stands for so many times that is repeated
REPEATED = 3.0
#: who says 0 may feel no motion yet, as sensors of pulses do up to some km/h: so many times `MOVED_MPS`
AT_REST = 3.0
#: too late, or not tied to the road
_NO_WITNESS = ("engine_speed", "gps_speed")


@dataclass(slots=True)
class _Shown:
    """What another speed has shown since this one stands, m/s."""

    least: float = math.inf
    largest: float = -math.inf
    last: float = math.nan

    def range_mps(self, column: FloatColumn) -> FloatColumn:
        """Return over which range it has moved so far (n,); who jumps shows no motion and begins anew."""
        moved = np.empty(len(column))
        jumps = np.abs(column - shifted(column, self.last)) > SPEED_SLACK_MPS
        bounds = [0, *np.flatnonzero(jumps).tolist(), len(column)]
        for i, (begin, end) in enumerate(pairwise(bounds)):
            if i:
                self.least, self.largest = math.inf, -math.inf
            if end > begin:
                low = np.fmin(np.fmin.accumulate(column[begin:end]), self.least)
                high = np.fmax(np.fmax.accumulate(column[begin:end]), self.largest)
                moved[begin:end] = high - low
                self.least, self.largest = float(low[-1]), float(high[-1])
        self.last = float(column[-1])
        return moved


@dataclass(slots=True)
class _Watch:
    """One speed: how long it must stand, who else shows the motion, and what has been seen so far."""

    ticks: int
    #: role -> m/s per unit
    witnesses: dict[str, float]
    #: roles of the same message, itself included
    mates: list[str]
    value: float = math.nan
    since_tick: int = 0
    shown: dict[str, _Shown] = field(default_factory=dict)


class Frozen:
    """Carries how long every speed has stood still; counts the ticks on which it was refuted, per role."""

    def __init__(self, config: Config) -> None:
        self.counts: Counter[str] = Counter()
        in_use = next((role for role in SPEED_ORDER if role in config.signals), "engine_speed")
        watched = dict.fromkeys((in_use, "engine_speed"))
        self._watched = {role: w for role in watched if (w := _watch(config, role)) is not None}

    def silence(self, ticks: GridBlock) -> GridBlock:
        """Return the ticks with what is frozen as stale."""
        tick = ticks.t_us // STEP_US
        silent: dict[str, BoolColumn] = {}
        for role, watch in self._watched.items():
            refuted = self._refuted(role, watch, ticks, tick)
            if refuted is None:
                continue
            self.counts[role] += int(np.count_nonzero(refuted))
            for mate in watch.mates:
                silent[mate] = refuted | silent[mate] if mate in silent else refuted
        if not silent:
            return ticks
        values = {role: np.where(where, np.nan, ticks.values[role]) for role, where in silent.items()}
        stale = {role: ticks.stale[role] | where for role, where in silent.items()}
        return replace(ticks, values={**ticks.values, **values}, stale={**ticks.stale, **stale})

    def _refuted(self, role: str, watch: _Watch, ticks: GridBlock, tick: IntColumn) -> BoolColumn | None:
        """Return where a speed is frozen (n,), None where it is not; remember what the next block needs."""
        values = ticks.values[role]
        same = values == shifted(values, watch.value)
        if not ticks.continues:
            same[0] = False
        watch.value = float(values[-1])
        if not np.count_nonzero(same):
            watch.since_tick = int(tick[-1])
            watch.shown.clear()
            return None
        began = np.maximum.accumulate(np.where(same, watch.since_tick if same[0] else tick[0], tick))
        settled = same & (tick - began >= SETTLED_S * RATE_HZ)
        watch.since_tick = int(began[-1])
        refuted = self._contradicted(watch, ticks, values, settled) & (tick - began >= watch.ticks)
        return refuted if np.count_nonzero(refuted) else None

    @staticmethod
    def _contradicted(
        watch: _Watch, ticks: GridBlock, values: FloatColumn, settled: BoolColumn
    ) -> BoolColumn:
        """Return where a witness has shown motion while the speed stood (n,)."""
        found = np.zeros(len(values), np.bool_)
        if not settled[-1] and not np.count_nonzero(settled):
            watch.shown.clear()
            return found
        edges = np.flatnonzero(settled[1:] != settled[:-1]) + 1
        bounds = [0, *edges.tolist(), len(values)]
        for begin, end in pairwise(bounds):
            if not settled[begin]:
                watch.shown.clear()
                continue
            slack = MOVED_MPS * (1.0 if values[begin] else AT_REST)
            for role, scale in watch.witnesses.items():
                shown = watch.shown.setdefault(role, _Shown())
                found[begin:end] |= shown.range_mps(scale * ticks.values[role][begin:end]) > slack
        return found


def _watch(config: Config, role: str) -> _Watch | None:
    """Return how a speed is watched, None where nothing could tell that it is frozen."""
    vehicle, signals = config.vehicle, config.signals
    if role not in signals:
        return None
    metres = math.pi / 30 / vehicle.final_drive * vehicle.wheel_radius_m
    mates = [other for other in signals if other not in LASTING and _together(config, role, other)]
    witnesses = {
        other: metres if other == "output_shaft_speed" else 1.0
        for other in SPEED_ORDER
        if other in signals and other not in _NO_WITNESS and other not in mates
    }
    stale_s = signals[role].stale_s
    stale_s = ROLES[role].stale_s if stale_s is None else stale_s
    if not witnesses or not math.isfinite(stale_s):
        return None
    return _Watch(math.ceil(max(SETTLED_S, REPEATED * stale_s) * RATE_HZ), witnesses, mates)


def _together(config: Config, role: str, other: str) -> bool:
    """Return whether two roles come in one message of one sender."""
    a, b = config.signals[role], config.signals[other]
    return role == other or (a.message is not None and (a.message, a.source) == (b.message, b.source))
