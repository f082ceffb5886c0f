"""Scenarios of what cannot be are refused in one line."""

from __future__ import annotations

import pytest

from canest.core.errors import ConfigError
from canest.simulation.reading import load_scenario
from canest.simulation.run import simulate

SCENARIO = {
    "duration_s": 30, "vehicle": "class8", "mass_kg": 21250, "road": {"kind": "flat"},
    "driver": {"kind": "pulses"}, "bus": {"traffic": False},
}  # fmt: skip


@pytest.mark.parametrize(
    ("undeclared", "message"),
    [
        ({"effect": "payload_change", "mass_delta_kg": 1000, "t_s": -5}, "payload_change before the drive"),
        ({"effect": "drag_area", "cda_delta_m2": -20}, "drag_area takes too much"),
        ({"effect": "rotating_inertia", "inertia_kgm2": -9}, "rotating_inertia takes too much"),
        ({"effect": "driveline_loss", "loss": 0.1, "gear": 99}, "no such gear, found 99"),
    ],
)
def test_an_effect_that_cannot_be(undeclared, message):
    with pytest.raises(ConfigError, match=message):
        simulate({**SCENARIO, "undeclared": [undeclared]})


def test_a_step_that_is_never_reached():
    road = {"kind": "steps", "grades": [0.0, 0.03], "length_m": 100, "transition_m": 150}
    with pytest.raises(ConfigError, match="transition_m 150 is no part of a step"):
        load_scenario({**SCENARIO, "road": road})
