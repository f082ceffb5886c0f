"""How often the engine turns for each time that a gear ratio from the bus says it does."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn

#: pairs that a comparison needs, and how many of them are kept
_LEAST_PAIRS, _MOST_PAIRS = 100, 30_000
#: a gear stays in where the ratio changes less from report to report
_STAYS = 0.01
#: the middle half of the pairs spreads further where a clutch or converter slips most of the time
_SPREAD = 0.05


class ReportedRatio:
    """Streams simultaneous speeds and ratios; memory does not grow with the log."""

    def __init__(self) -> None:
        self._times: FloatColumn = np.empty(0)
        self.has_values = False

    def push(
        self, ratio: FloatColumn, engine_rpm: FloatColumn, shaft_rpm: FloatColumn, least_rpm: float
    ) -> None:
        """Take ratios and speeds at their stamps (n,), NaN where there is none. least_rpm: of the shaft."""
        self.has_values = self.has_values or bool(np.isfinite(ratio).any())
        if len(ratio) < 3 or len(self._times) >= _MOST_PAIRS:
            return
        with np.errstate(invalid="ignore", divide="ignore"):  # a comparison with NaN is False
            steps = np.abs(np.diff(ratio)) < _STAYS * ratio[1:]
            sound = (ratio[1:-1] > 0.0) & (engine_rpm[1:-1] > 0.0) & (shaft_rpm[1:-1] > least_rpm)
            times = engine_rpm[1:-1] / (shaft_rpm[1:-1] * ratio[1:-1])
        stays = steps[:-1] & steps[1:] & sound
        self._times = np.concatenate((self._times, times[stays]))[:_MOST_PAIRS]

    def times(self) -> float:
        """Return how many times as often as they have it the engine turns; 1 where nobody knows."""
        if len(self._times) < _LEAST_PAIRS:
            return 1.0
        low, middle, high = np.percentile(self._times, (25, 50, 75))
        return float(middle) if high - low < _SPREAD * middle else 1.0
