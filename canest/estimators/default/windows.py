"""Momentum windows (shared with version 0.1 of the estimator)."""

from canest.estimators.canest_0_1.windows import COLUMNS, SHIFT, WINDOW_S, Windows

__all__ = ["COLUMNS", "SHIFT", "WINDOW_S", "Windows"]
