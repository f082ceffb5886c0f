from types import SimpleNamespace

import numpy as np
import pytest

from canest.vehicle.effects import effect_from_config


def test_cold_adds_rolling_resistance_and_an_unknown_temperature_none():
    effect = effect_from_config({"effect": "rolling_resistance_temperature", "crr_per_K": 1e-4})
    degrees = np.array([20.0, 0.0, 30.0, np.nan])
    columns = SimpleNamespace(
        mu=np.full(4, 0.006),
        signal=lambda role, missing: np.where(np.isnan(degrees), missing, degrees),
    )
    effect.apply(columns)
    assert columns.mu == pytest.approx([0.006, 0.008, 0.005, 0.006])
    assert effect.signal == "ambient_temperature"
