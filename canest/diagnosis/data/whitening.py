"""Whitening: an unknown grade, whose error decays over distance, is filtered out of every column."""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.drive_part import DrivePart

#: what is left of speed quantisation and oscillation in a one-second mean, as specific force (m/s2)
WINDOW_NOISE_MPS2 = 0.004


def innovations(x_N: FloatColumn | None, part: DrivePart) -> FloatColumn:
    """Run the scalar grade filter over a column: state = grade error force, decaying over distance.

    Without a column: the standard deviations of the innovations, N.
    """
    noise = (WINDOW_NOISE_MPS2 * part.mass_w) ** 2
    spread = (part.reference.sin_beta_std * GRAVITY_MPS2 * part.mass_w) ** 2
    n = part.windows.count
    if part.reference.sin_beta_std == 0.0:
        return np.sqrt(noise) if x_N is None else np.asarray(x_N / np.sqrt(noise))
    out = np.empty(n)
    state, variance, before = 0.0, float(spread[0]), float(part.windows.t_s[0])
    for k in range(n):
        now = float(part.windows.t_s[k])
        keep = np.exp(-(now - before) * part.speed_mps[k] / part.reference.correlation_m)
        before = now
        state, variance = keep * state, keep * keep * variance + (1 - keep * keep) * spread[k]
        s = variance + noise[k]
        gain = variance / s
        if x_N is None:
            out[k] = np.sqrt(s)
        else:
            innovation = x_N[k] - state
            out[k] = innovation / np.sqrt(s)
            state += gain * innovation
        variance *= 1 - gain
    return out
