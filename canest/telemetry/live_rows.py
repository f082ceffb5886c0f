"""What a live view draws: ten rows a second of estimates, signals and the residual.

Collected only while somebody watches, after the estimation has done its work.
"""

from __future__ import annotations

from collections import deque
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core.samples import STEP_US, EstimateBlock, ModelBlock
from canest.telemetry.live_protocol import DECIMALS, Row
from canest.vehicle.residual import residual_N

ROW_US = 100_000  #: a row for every tick that is a multiple of it
_STRIDE = ROW_US // STEP_US
_DIGITS = [decimals or None for decimals in DECIMALS.values()]  #: None: an integer
_MOST = 600  #: rows that wait; more come only from a bus that was read late


class LiveRows:
    """Rows since the last `take`, and the newest tick of all.

    wanted: whether anybody watches; `add` does nothing otherwise.
    newest: the row of the newest tick, whatever its time; None while there is none.
    """

    def __init__(self) -> None:
        self.wanted = False
        self.newest: Row | None = None
        self._rows: deque[Row] = deque(maxlen=_MOST)

    def add(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples (n,) and their estimates (n,)."""
        if not self.wanted:
            return
        first = -(int(samples.t_us[0]) // STEP_US) % _STRIDE
        *rows, self.newest = _rows(samples, estimates, [*range(first, len(samples), _STRIDE), -1])
        self._rows.extend(rows)

    def take(self) -> list[Row]:
        """Return the rows since the last call."""
        rows = list(self._rows)
        self._rows.clear()
        return rows


@np.errstate(all="ignore")  # signals may be any float
def _rows(samples: ModelBlock, estimates: EstimateBlock, positions: list[int]) -> list[Row]:
    """Return the rows at some positions. A block is short: whole columns as lists cost least."""
    residual = residual_N(estimates.mass_kg, samples.accel_mps2, estimates.grade, samples.mu, samples.force_N)
    residual[samples.gate != 0] = np.nan  # what is gated is not explained by the model, and need not be
    columns: tuple[NDArray[Any], ...] = (
        samples.t_us * 1e-6,
        estimates.mass_kg,
        estimates.mass_std_kg,
        estimates.grade,
        estimates.grade_std,
        estimates.status,
        samples.gate,
        samples.raw_speed_mps,
        samples.raw_torque_Nm,
        samples.gear,
        residual,
    )
    rounded = [
        [round(x, digits) if isfinite(x) else None for x in map(column.tolist().__getitem__, positions)]
        for column, digits in zip(columns, _DIGITS, strict=True)
    ]
    return [list(row) for row in zip(*rounded, strict=True)]
