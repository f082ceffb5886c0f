"""What the lake keeps of a drive, taken while its estimates stream by: the samples, and two rows per second.

Memory grows by some bytes per second of driving, not per frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from canest.core.columns import shifted
from canest.core.frames import FloatColumn, IntColumn, MonotonicClock
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS, STEP_S, STEP_US, EstimateBlock, ModelBlock
from canest.fleet.job import Settings
from canest.fleet.tables import POSITIONS, SAMPLES, TableWriter
from canest.grid.grid import GridBlock
from canest.vehicle.residual import needed_mps2

SECOND_US = 1_000_000
#: stamps between these are taken for time since 1970: from 1985 to the year 3000
EPOCH_US, CALENDAR_END_US = 10**15 // 2, 32_503_680_000 * 10**6
#: columns of the rows on whole seconds; passed_us: as in `canest.offline.leg.Leg`
ON_SECONDS = ("passed_us", "gate", "reported_mass_kg")
#: columns of the means over seconds without a closed gate: their end, what a mass of 1 kg takes
#: (a + g sin b + g mu cos b), and what pushes it
OPEN_SECONDS = ("passed_us", "needed_mps2", "force_N", "traction_N")
_TICKS_PER_SECOND = SECOND_US // STEP_US
_REPORTED, _LATITUDE, _LONGITUDE = "reported_mass", "latitude", "longitude"


class Recording:
    """A pipeline's listener, for samples and for ticks.

    log: for the column of this name. samples: the file of samples, None without any.
    """

    def __init__(self, log: str, settings: Settings, metadata: Mapping[str, str]) -> None:
        self._log = log
        self._step_us = SECOND_US // settings.samples_hz if settings.samples_hz else 0
        positions = POSITIONS if settings.positions else {}
        self.samples = TableWriter({**SAMPLES, **positions}, metadata) if self._step_us else None
        self._positions = bool(positions)
        self._ticks: list[GridBlock] = []
        self._seconds: dict[str, list[FloatColumn]] = {name: [] for name in ON_SECONDS}
        self._means = _OpenSeconds()
        self._speeds: list[FloatColumn] = []
        self._distance_m = 0.0
        self._position = _Position()
        self._monotonic = MonotonicClock()
        self.first_us: int | None = None

    def take_ticks(self, ticks: GridBlock) -> None:
        """Take what the roles were; the samples of the same ticks follow, perhaps in parts."""
        self._ticks.append(ticks)

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples with their estimates."""
        if not len(samples):
            return
        if self.first_us is None:
            self.first_us = int(samples.t_us[0])
        speed = np.where(samples.stopped, 0.0, np.abs(samples.raw_speed_mps))
        self._speeds.append(speed)
        roles = self._roles(len(samples))
        passed_us = self._monotonic(samples.t_us)
        whole = np.flatnonzero(passed_us % SECOND_US == 0)
        self._means.add(replace(samples, t_us=passed_us), estimates)
        on_seconds: tuple[Any, ...] = (passed_us, samples.gate, roles[_REPORTED])
        for name, column in zip(ON_SECONDS, on_seconds, strict=True):
            self._seconds[name].append(np.asarray(column[whole], np.float64))
        way_m = self._distance_m + np.cumsum(np.nan_to_num(speed)) * STEP_S
        self._distance_m = float(way_m[-1])
        if self.samples is not None:
            self._write(samples, estimates, speed, way_m, roles)

    def taken_speeds(self) -> FloatColumn:
        """Return the speeds since the last call, m/s (n,): 0 while standing, NaN where not known."""
        speed = np.concatenate(self._speeds) if self._speeds else np.empty(0)
        self._speeds.clear()
        return speed

    def seconds(self) -> dict[str, FloatColumn]:
        """Return the rows on whole seconds, columns of `ON_SECONDS` (n,)."""
        return _joined(self._seconds)

    def open_seconds(self) -> dict[str, FloatColumn]:
        """Return the means over seconds without a closed gate, columns of `OPEN_SECONDS` (n,)."""
        return _joined(self._means.rows)

    def _roles(self, count: int) -> dict[str, FloatColumn]:
        """Return the values of the roles that the tables want, of the next ``count`` ticks."""
        found: dict[str, list[FloatColumn]] = {_REPORTED: [], _LATITUDE: [], _LONGITUDE: []}
        while count:
            ticks = self._ticks[0]
            if len(ticks) > count:
                ticks, self._ticks[0] = ticks.split(count)
            else:
                del self._ticks[0]
            count -= len(ticks)
            for role, parts in found.items():
                parts.append(ticks.values.get(role, np.full(len(ticks), np.nan)))
        return {role: np.concatenate(parts) for role, parts in found.items()}

    def _write(
        self,
        samples: ModelBlock,
        e: EstimateBlock,
        speed: FloatColumn,
        way_m: FloatColumn,
        roles: Mapping[str, FloatColumn],
    ) -> None:
        position_m = self._position.since(roles[_LATITUDE], roles[_LONGITUDE], way_m)
        at = np.flatnonzero(samples.t_us % self._step_us < STEP_US)
        if not len(at) or self.samples is None:
            return
        t_us = samples.t_us[at]
        columns = {
            "log": [self._log] * len(at),
            "time": calendar(t_us),
            "t_s": t_us / 1e6,
            "distance_m": way_m[at],
            "speed_mps": np.where(np.isfinite(speed[at]), speed[at], np.nan),
            "grade": e.grade[at],
            "grade_std": e.grade_std[at],
            "mass_kg": e.mass_kg[at],
            "mass_std_kg": e.mass_std_kg[at],
            "status": [STATUS_LABELS[int(code)] for code in e.status[at]],
            "gate": [LABELS[int(code)] for code in samples.gate[at]],
            "altitude_m": samples.altitude_m[at],
        }
        if self._positions:
            columns |= {
                "latitude_deg": roles[_LATITUDE][at],
                "longitude_deg": roles[_LONGITUDE][at],
                "position_m": position_m[at],
            }
        self.samples.write(columns)


class _OpenSeconds:
    """Takes means over whole seconds in which every gate is open, whatever the cut of the blocks.

    Single samples would not do: between a force and the acceleration that it causes lie some samples, and
    the error of either looks like a force that is missing.
    """

    def __init__(self) -> None:
        self.rows: dict[str, list[FloatColumn]] = {name: [] for name in OPEN_SECONDS}
        self._rest = np.empty((len(OPEN_SECONDS), 0))

    def add(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples with their estimates."""
        needed = needed_mps2(samples.accel_mps2, estimates.grade, samples.mu)
        used = samples.gate == 0
        columns = np.stack(
            [
                samples.t_us,
                *(np.where(used, c, np.nan) for c in (needed, samples.force_N, samples.traction_N)),
            ]
        )
        columns = np.concatenate([self._rest, columns], axis=1)
        second = (columns[0] // SECOND_US).astype(np.int64)
        begins = np.flatnonzero(np.diff(second, prepend=second[0] - 1))
        # the last second may go on in the next block
        self._rest = columns[:, begins[-1] :]
        whole = begins[:-1][np.diff(begins) == _TICKS_PER_SECOND]
        seconds = columns[:, whole[:, None] + np.arange(_TICKS_PER_SECOND)]
        for name, values in zip(OPEN_SECONDS, seconds, strict=True):
            self.rows[name].append(values[:, -1] if name == "passed_us" else values.mean(axis=1))


def _joined(columns: Mapping[str, list[FloatColumn]]) -> dict[str, FloatColumn]:
    return {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in columns.items()}


class _Position:
    """Carries how far the vehicle had come when the position that is held came."""

    def __init__(self) -> None:
        self._last = (math.nan, math.nan, math.nan)

    def since(self, latitude: FloatColumn, longitude: FloatColumn, way_m: FloatColumn) -> FloatColumn:
        """Return the distance at which the position in force came, m (n,)."""
        before = [
            shifted(column, last) for column, last in zip((latitude, longitude), self._last, strict=False)
        ]
        new = (latitude != before[0]) | (longitude != before[1])
        last = np.maximum.accumulate(np.where(new, np.arange(len(new)), -1))
        came_m = np.where(last < 0, self._last[2], way_m[last])
        self._last = float(latitude[-1]), float(longitude[-1]), float(came_m[-1])
        return came_m


def calendar(t_us: IntColumn) -> np.ndarray[tuple[int, ...], np.dtype[np.datetime64]]:
    """Return stamps as times UTC (n,), not-a-time where the clock is no calendar."""
    known = (t_us > EPOCH_US) & (t_us < CALENDAR_END_US)
    return np.where(known, t_us, np.iinfo(np.int64).min).astype("datetime64[us]")
