"""Mass selection by concurrent filters (`ekf-select`): 2014 paper, "Mass Selection Method" and eq. 18."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from canest.core.frames import FloatColumn, MonotonicClock
from canest.core.samples import STEP_S, STEP_US, EstimateBlock, ModelBlock
from canest.estimators.description import Description, option
from canest.estimators.papers.kidambi2014.ekf import EkfBase, EkfOptions
from canest.estimators.papers.kidambi2014.ekf_filter import EkfCore, Rows


class EkfSelectOptions(EkfOptions):
    """Options of the ensemble."""

    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        "2014": {
            "q": (0.1, 1e-5, 25.0),
            "r": 100.0,
            "rate_hz": 30.0,
            "p0": (0.001, 10.0),
            "every_s": 5.0,
            "filters": 5,
            "variation": 0.01,
            #: the paper has no such condition
            "narrowed": 1e6,
        },
    }

    every_s: float = option(5.0, "a new filter starts this often", unit="s", ge=0.1, le=3600.0)
    filters: int = option(
        5, "so many run at once; the oldest stops when a new one would be one too many", ge=2, le=50
    )
    variation: float = option(
        0.01, "coefficient of variation of their masses below which they agree (eq. 18)", gt=0.0, lt=1.0
    )
    narrowed: float = option(
        0.5,
        "agreement counts once every filter has narrowed the std of 1/M to this share",
        gt=0.0,
    )


class EkfSelect(EkfBase):
    """Filters started every five seconds from the latest estimates, covariance anew; mass where they agree.

    Each new filter starts from the estimate of the one begun just before it. Where the paper is silent: an
    ensemble that has seen no excitation agrees trivially (all copies of one start value), so agreement
    counts only after every filter has narrowed the variance of 1/m well below its start. Until the
    first agreement the mass is the mean of the filters; afterwards it is the mean at the last agreement.
    The standard deviation joins that of the oldest filter, which knows most, and the spread of all.
    """

    descriptions = (
        Description(
            "ekf-select",
            "concurrent filters, mass where they agree",
            "2014, eq. 18",
            options=EkfSelectOptions,
        ),
    )

    def _start(self, theta: tuple[float, float], variance: tuple[float, float]) -> None:
        self._variance = variance
        self._filters = [EkfCore(self.options, self.box, theta, variance)]
        self._selected: tuple[float, float] | None = None  # 1/m and its variance at the last agreement
        self._next_us: int | None = None
        # a clock set back must not keep the next filter waiting until it has caught up
        self._monotonic = MonotonicClock()

    @property
    def running(self) -> int:
        """Return how many filters run at present."""
        return len(self._filters)

    def _update(self, block: ModelBlock) -> EstimateBlock:
        rows = Rows(block, self._before)
        self._before = rows.after
        every_us = round(self.options.every_s / STEP_S) * STEP_US
        parts = [np.empty((4, 0))]
        stamps = self._monotonic(block.t_us)
        times = stamps[rows.at]
        if self._next_us is None and len(block):
            self._next_us = int(stamps[0]) + every_us
        begin = 0
        while begin < len(times):
            assert self._next_us is not None  # set above: there are samples
            end = int(np.searchsorted(times, self._next_us, side="left"))
            if end > begin:
                parts.append(self._select(rows, begin, end))
                begin = end
            if begin < len(times):
                self._spawn()
                late = int(times[begin]) - self._next_us
                self._next_us += (late // every_us + 1) * every_us
        known = np.concatenate(parts, axis=1)
        return self._hold(rows.at, self._numbers(known, rows.mu), len(block))

    def _spawn(self) -> None:
        """Start a filter from the estimates of the one begun just before it, with a new covariance."""
        latest = self._filters[-1]
        theta = (latest.state[1], latest.state[2])
        self._filters.append(EkfCore(self.options, self.box, theta, self._variance, latest))
        del self._filters[: -self.options.filters]

    def _select(self, rows: Rows, begin: int, end: int) -> FloatColumn:
        """Run every filter over the rows; return the ensemble's theta and variances, shape (4, k)."""
        runs = np.stack([f.run(rows, begin, end) for f in self._filters])  # (filters, 5, k)
        count = len(runs)
        total = runs[0].copy()
        for run in runs[1:]:
            total += run
        mean = total / count
        spread = np.zeros((2, end - begin))
        masses = 1.0 / runs[:, 0]
        mass_mean = _mean(masses)
        mass_spread = np.zeros(end - begin)
        for run, mass in zip(runs, masses, strict=True):
            spread += (run[:2] - mean[:2]) ** 2
            mass_spread += (mass - mass_mean) ** 2
        spread /= max(1, count - 1)
        variation = np.sqrt(mass_spread / max(1, count - 1)) / mass_mean
        narrow = runs[:, 4].max(axis=0) < (self.options.narrowed**2) * self._variance[0]
        agreed = (count >= self.options.filters) & narrow & (variation < self.options.variation)
        theta1, var1 = mean[0], runs[0, 2] + spread[0]
        # the value at the last agreement, carried forward
        index = np.maximum.accumulate(np.where(agreed, np.arange(1, end - begin + 1), 0))
        before = self._selected
        chosen = np.concatenate(([before[0] if before else np.nan], theta1))[index]
        chosen_var = np.concatenate(([before[1] if before else np.nan], var1))[index]
        theta1 = np.where(np.isnan(chosen), theta1, chosen)
        var1 = np.where(np.isnan(chosen), np.maximum(var1, self._variance[0] / 4.0), chosen_var)
        if not np.isnan(chosen[-1]):
            self._selected = (float(chosen[-1]), float(chosen_var[-1]))
        return np.stack((theta1, mean[1], var1, runs[0, 3] + spread[1]))


def _mean(columns: FloatColumn) -> FloatColumn:
    """Return the mean over the first axis, added in order (the same bits for any number of columns)."""
    total = columns[0].copy()
    for column in columns[1:]:
        total += column
    return np.asarray(total / len(columns))
