"""Drives whose grade is known from an accelerometer alone, with the mass given."""

import numpy as np
import pytest

from canest.config import load_config
from canest.diagnosis.run import diagnose

HILLS = {"kind": "sine", "amplitude": 0.05, "wavelength_m": 400}
SHORT_HILLS = {"kind": "sine", "amplitude": 0.05, "wavelength_m": 300}


@pytest.fixture(scope="module")
def without_altitude(drive):
    def found(*undeclared, **changes):
        log = drive(*undeclared, seed=3, **changes)
        config = load_config(log.with_suffix(".yaml"))
        signals = {role: source for role, source in config.signals.items() if role != "altitude"}
        return diagnose([log], config.model_copy(update={"signals": signals}), mass_kg=21250.0)

    return found


def test_a_road_rougher_than_a_highway_is_no_other_wheel_radius(without_altitude):
    """Part of the road was put down to the pitch of the body, and what was then wrong to the radius."""
    planted = {"effect": "torque_gain", "gain": 0.85}
    found = without_altitude(planted, road=HILLS, driver={"kind": "mixed"})
    chosen = {c.candidate.label: c.value for c in found.search.chosen}
    assert chosen.keys() - {"torque_delay"} == {"torque_gain"}
    assert chosen["torque_gain"] == pytest.approx(0.85, abs=0.02)
    assert found.before.mass_error_pct > 15.0
    assert abs(found.after.mass_error_pct) < 1.0


def test_the_bias_of_the_accelerometer_is_no_residual_before_either(without_altitude):
    before_N = without_altitude(road={"kind": "highway"}).residual_before_N
    assert abs(before_N.mean()) < 0.1 * np.sqrt((before_N**2).mean())


def test_a_driver_who_slows_uphill_makes_no_fault(without_altitude):
    """A wheel radius of 0.84 was found, and put the right mass wrong by 15 %."""
    found = without_altitude(road=SHORT_HILLS)
    assert not found.search.chosen
    assert abs(found.after.mass_error_pct) < 1.0


def test_what_the_reference_may_be_off_by_is_not_counted_as_left_over(without_altitude):
    problem = without_altitude(road=SHORT_HILLS).problem
    (pitch,) = problem.reference_errors().values()
    for stds, left in ((1.0, pytest.approx(0.0, abs=0.1)), (30.0, pytest.approx(1.0, abs=0.1))):
        found = problem.held_out(stds * pitch, [])
        assert np.sqrt((found**2).mean() / ((stds * pitch) ** 2).mean()) == left
