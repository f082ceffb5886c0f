"""The doctor on torques that are none: what is a fault of the sender, and what of the config."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import load_config
from canest.doctor.torque_samples import TorqueSampleCheck


def samples_of(values, cut=1000, role="engine_torque", where="bmw-i3"):
    """Return what is said of a torque that reads these values (n,), 50 times a second."""
    config = load_config(where)
    source = next(iter(config.signals.values()))
    judge = TorqueSampleCheck(config.model_copy(update={"signals": {role: source}}))
    t_us = np.arange(len(values), dtype=np.int64) * 20_000
    for first in range(0, len(values), cut):
        judge.push({role: (t_us[first : first + cut], values[first : first + cut])})
    return judge.hints()


def noisy(n=20_000, std=20.0, scale=1.0):
    """Return a torque in N m with white noise, as coarse as a bus makes it (n,)."""
    torque = 380 + 470 * np.sin(np.arange(n) / 500) + np.random.default_rng(1).normal(0, std, n)
    return scale * np.round(torque / 2) * 2


@pytest.mark.parametrize(
    "values",
    [
        noisy(),
        noisy(std=60.0),
        noisy(std=2.0, scale=10.0),
        noisy(std=60.0, scale=1000.0),
        (10 * noisy(std=2.0)).astype("<i2").byteswap() / 10.0,
        np.stack([noisy(10_000), noisy(10_000)[::-1]]).T.ravel(),
    ],
    ids=["noise", "much noise", "ten times", "kNm", "byte order", "two vehicles"],
)
def test_no_fixed_number_is_made_of_noise(values):
    assert samples_of(values) == []


@pytest.mark.parametrize("cut", [7, 1000])
def test_a_fixed_number_stands_out_of_noise_whatever_the_torque_is_scaled_by(cut):
    for std, scale in ((2.0, 1.0), (20.0, 1.0), (20.0, 0.001)):
        values = noisy(std=std, scale=scale)
        values[500::1000] = 0.0
        (hint,) = samples_of(values, cut)
        assert "reads exactly zero in " in hint
