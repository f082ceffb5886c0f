"""Engine torque in eighths of a percent: SPN 513 plus SPN 4154, where both are sent."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from canest.core.frames import FloatColumn

WHOLE, FRACTION = "engine_torque_pct", "engine_torque_fraction"


def with_fraction(signals: Mapping[str, FloatColumn]) -> FloatColumn:
    """Return the reported torque in percent (n,).

    The fraction has four bits: 0 to 7 are eighths, and 15 is "not available". What is none adds nothing.
    """
    if FRACTION not in signals:
        return signals[WHOLE]
    eighths = signals[FRACTION]
    return np.where((eighths >= 0.0) & (eighths < 1.0), signals[WHOLE] + eighths, signals[WHOLE])
