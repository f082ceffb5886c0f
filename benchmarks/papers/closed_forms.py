"""What the figures need beside canest: a filter's order from two frequencies, the data correction of TLS."""

from __future__ import annotations

import math

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import RATE_HZ


def order_and_cutoff(
    pass_hz: float, stop_hz: float, *, pass_dB: float = 3.0, stop_dB: float = 40.0
) -> tuple[int, float]:
    """Return the lowest Butterworth order, and its cut-off in Hz, for a pass and a stop frequency.

    The 2013 paper names its filter so: third order, 1 Hz pass, 10 Hz stop.
    """
    warp = math.tan(math.pi * stop_hz / RATE_HZ) / math.tan(math.pi * pass_hz / RATE_HZ)
    gain = (10 ** (stop_dB / 10) - 1) / (10 ** (pass_dB / 10) - 1)
    order = max(1, math.ceil(math.log10(gain) / (2 * math.log10(warp))))
    scale = (10 ** (pass_dB / 10) - 1) ** (-1 / (2 * order))
    return order, math.atan(math.tan(math.pi * pass_hz / RATE_HZ) * scale) * RATE_HZ / math.pi


def correction(a: FloatColumn, b: FloatColumn) -> FloatColumn:
    """Return the TLS data correction [dA dB] = [A B] v v^T of 2013, eq. 6 (no U needed), shape (m, q)."""
    z = np.column_stack((a, b))
    v = np.linalg.svd(z)[2][-1]
    return np.asarray(np.outer(z @ v, v))
