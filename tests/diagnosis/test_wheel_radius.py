"""What bounds a wheel radius: a speed that no wheel counts, and no agreement of those that wheels do."""

import pytest

from canest.config import load_config
from canest.diagnosis.run import diagnose
from canest.diagnosis.search.candidates import candidates_for

RADIUS = {"effect": "wheel_radius", "factor": 0.95}
GAIN = {"effect": "torque_gain", "gain": 1.2}
SHORT_HILLS = {"kind": "sine", "amplitude": 0.04, "wavelength_m": 300}


@pytest.fixture(scope="module")
def diagnosed_with(drive):
    def found(*undeclared, satellites=True, effects=(), **changes):
        log = drive(*undeclared, seed=3, **changes)
        config = load_config(log.with_suffix(".yaml"))
        signals = {r: s for r, s in config.signals.items() if r not in ("altitude", "undriven_speed")}
        if satellites:  # the undriven axle of these drives has tyres as declared
            signals["gps_speed"] = config.signals["undriven_speed"]
        config = config.model_copy(update={"signals": signals, "effects": effects})
        return diagnose([log], config, mass_kg=21250.0)

    return found


def radius_std(diagnosis):
    return next(c.scale for c in candidates_for(diagnosis.problem) if c.effect == "wheel_radius")


def test_satellites_that_confirm_the_radius_bound_it(diagnosed_with):
    assert radius_std(diagnosed_with()) < 0.012
    assert radius_std(diagnosed_with(satellites=False)) == 0.03


def test_speeds_of_driven_wheels_agree_with_a_wrong_radius_and_bound_nothing(diagnosed_with):
    found = diagnosed_with(RADIUS, satellites=False)
    signals, vehicle = found.problem.parts[0].run.signals, found.config.vehicle
    moving = signals["vehicle_speed"] > 10.0
    shaft_mps = signals["output_shaft_speed"][moving] * vehicle.mps_per_shaft_rpm
    assert shaft_mps / signals["vehicle_speed"][moving] == pytest.approx(1.0, abs=0.05)
    assert radius_std(found) == 0.03


def test_satellites_that_contradict_the_radius_leave_it_as_likely_as_a_fault(diagnosed_with):
    assert radius_std(diagnosed_with(RADIUS)) == 0.03


def test_a_radius_that_the_config_corrects_is_not_measured_again(diagnosed_with):
    assert radius_std(diagnosed_with(RADIUS, effects=(RADIUS,))) == 0.03


def test_torque_is_not_put_down_to_a_radius_that_satellites_confirm(diagnosed_with):
    found = diagnosed_with(GAIN, road=SHORT_HILLS)
    assert all("wheel_radius" not in rival.names for rival in found.search.rivals)
    assert "torque_gain" in [c.candidate.effect for c in found.search.chosen]
    assert "wheel_radius" not in found.not_excluded
