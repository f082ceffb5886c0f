"""Where the vehicle is: the road laid on a plane by its curvature, as a satellite receiver reports it."""

from __future__ import annotations

import math

import numpy as np

from canest.core.frames import FloatColumn
from canest.simulation.packing import ALL_ONES, Scale, payload
from canest.simulation.scenario import Positions
from canest.simulation.sensors import Signals

#: SAE J1939-71: 1e-7 degrees, offset -210 degrees, raw values above 0xFAFFFFFF are no numbers
TOP32 = 0xFAFF_FFFF
SPN_584 = Scale(0, 32, 1e-7, -210, TOP32)  #: latitude, deg
SPN_585 = Scale(32, 32, 1e-7, -210, TOP32)  #: longitude, deg
EARTH_RADIUS_M = 6_371_008.8  #: mean (IUGG)
# All chosen.
WANDER_TAU_S = 60.0  #: the receiver's error wanders this slowly
WHITE = 0.2  #: white noise on top, share of the receiver's noise
DELAY_S = 0.2  #: a receiver reports where the vehicle was
JUMP_S = (2.0, 15.0)  #: how long a receiver is deceived, between the two


class Receiver:
    """A satellite receiver; its drawings are its own, so that no other signal depends on it."""

    def __init__(self, signals: Signals, spec: Positions, rng: np.random.Generator) -> None:
        self._signals, self._spec, self._rng = signals, spec, rng
        table = signals.table
        steps = np.diff(table["distance_m"], prepend=0.0)
        heading = math.radians(spec.heading_deg) - np.cumsum(table["curvature_1pm"] * steps)
        level = steps / np.sqrt(1.0 + table["grade"] ** 2)  # distance is along the road
        self._north_m = np.cumsum(level * np.cos(heading))
        self._east_m = np.cumsum(level * np.sin(heading))

    def position(self, t: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
        """Return latitude and longitude in degrees as reported at times t (n,)."""
        spec, at = self._spec, t - DELAY_S
        jump_north, jump_east = self._jumps(t)
        north = np.interp(at, self._signals.t_s, self._north_m) + self._error(t) + jump_north
        east = np.interp(at, self._signals.t_s, self._east_m) + self._error(t) + jump_east
        latitude = spec.latitude_deg + np.degrees(north / EARTH_RADIUS_M)
        parallel_m = EARTH_RADIUS_M * math.cos(math.radians(spec.latitude_deg))
        return latitude, spec.longitude_deg + np.degrees(east / parallel_m)

    def frames(self, t: FloatColumn) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
        """Return payloads of Vehicle Position (PGN 65267) at times t (n,)."""
        latitude, longitude = self.position(t)
        lost = self._rng.random(len(t)) < self._spec.lost_share
        data = payload([SPN_584.field(latitude), SPN_585.field(longitude)], len(t))
        return np.where(lost, ALL_ONES, data)

    def _error(self, t: FloatColumn) -> FloatColumn:
        """Return an error in metres that wanders, with white noise on top."""
        spread = self._spec.noise_m
        step_s = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
        keep = math.exp(-step_s / WANDER_TAU_S)
        kicks = self._rng.normal(0.0, spread * math.sqrt(1 - keep * keep), len(t))
        wander, value = np.empty(len(t)), self._rng.normal(0.0, spread)
        for k, kick in enumerate(kicks):
            wander[k] = value
            value = keep * value + kick
        return wander + self._rng.normal(0.0, WHITE * spread, len(t))

    def _jumps(self, t: FloatColumn) -> tuple[FloatColumn, FloatColumn]:
        """Return how far the receiver is deceived, north and east, m."""
        spec = self._spec
        north, east = np.zeros(len(t)), np.zeros(len(t))
        hours = (t[-1] - t[0]) / 3600.0 if len(t) else 0.0
        for _ in range(int(self._rng.poisson(spec.jumps_per_hour * hours))):
            begin = self._rng.uniform(t[0], t[-1])
            during = (t >= begin) & (t < begin + self._rng.uniform(*JUMP_S))
            towards = self._rng.uniform(0.0, 2.0 * math.pi)
            north[during] += spec.jump_m * math.cos(towards)
            east[during] += spec.jump_m * math.sin(towards)
        return north, east
