"""What the doctor sees of the bus itself: its clock, messages that no role takes, and the mass at a bound."""

from __future__ import annotations

import pytest

from canest.doctor.check import Doctor
from canest.doctor.past_contradiction import PastContradiction
from canest.logs import open_log
from canest.offline.replay import replay
from canest.simulation import simulate
from tests.pulsing_truck import config_of, write_drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive"), 60)


def hints(log, config):
    with open_log(log) as reader:
        doctor = Doctor(config)
        for block in reader:
            doctor.push(block)
        return doctor.report().hints


def stamped(drive, folder, factor):
    """Write the log again as a clock would have it that runs so many times as fast."""
    log = folder / "stamped.log"
    with log.open("w") as file:
        for line in drive.read_text().splitlines():
            stamp, rest = line[1:].split(")", 1)
            file.write(f"({float(stamp) * factor:.6f}){rest}\n")
    return log


@pytest.mark.parametrize(
    ("factor", "what"),
    [(0.5, "2 times as often"), (2.0, "0.5 times as often"), (1.05, ""), (0.95, ""), (1.0, "")],
)
def test_a_clock_at_another_rate_shows_in_how_often_messages_come(drive, tmp_path, factor, what):
    found = [each for each in hints(stamped(drive, tmp_path, factor), config_of(drive)) if "as often" in each]
    assert [what in each and "time stamps" in each for each in found] == ([True] if what else [])


def test_one_message_at_a_rate_of_its_own_is_no_clock(drive, tmp_path):
    """An ECU may send a group twice as often as usual."""
    log = tmp_path / "twice.log"
    lines = drive.read_text().splitlines()
    twice = [line for line in lines for _ in range(2 if "CF00400#" in line else 1)]
    log.write_text("\n".join(twice))
    assert not any("as often" in each for each in hints(log, config_of(drive)))


@pytest.mark.parametrize(
    ("role", "message"), [("engine_friction_pct", "EEC3"), ("retarder_torque_pct", "ERC1")]
)
def test_a_group_on_the_bus_that_no_role_takes_is_named(drive, role, message):
    assert not any(f"the bus has {message}" in each for each in hints(drive, config_of(drive)))
    found = hints(drive, config_of(drive, without=(role,)))
    assert any(f"the bus has {message}, and no role takes it" in each for each in found), found


@pytest.mark.parametrize(
    ("overrides", "asked"),
    [
        ((), True),
        (("vehicle.friction_torque_pct=0",), False),
        (("vehicle.friction_torque_pct=8",), False),
        (("vehicle.gear_ratios={1: 1.0}",), False),  # a motor
    ],
)
def test_friction_is_asked_for_where_an_engine_has_one_and_nobody_states_it(drive, overrides, asked):
    found = hints(drive, config_of(drive, *overrides, without=("engine_friction_pct",)))
    assert any("no signal reports the engine's friction" in each for each in found) is asked


def test_a_bound_that_was_contradicted_for_a_while_is_noted_at_the_end():
    heavier = "the driving shows a vehicle heavier than vehicle.mass_max_kg = 40,000 kg: the bound is wrong"
    past = PastContradiction()
    assert past.notes("") == []
    past.note(f"{heavier}; the accelerometer does not follow")
    past.note("")
    assert past.notes("") == past.notes("another") == [f"at times {heavier}"]
    assert past.notes(heavier) == []  # the estimator says it itself


def test_check_and_replay_say_it(tmp_path):
    """A truck of 21 t with 15 t at most, unloaded at the end."""
    scenario = {
        "duration_s": 420, "vehicle": "class8", "driver": {"kind": "pulses"}, "road": {"kind": "highway"},
        "mass_kg": [{"t_s": 0, "mass_kg": 21250}, {"t_s": 200, "mass_kg": 12000}],
    }  # fmt: skip
    (log,) = (path for path in simulate(scenario, 1).write(tmp_path) if path.suffix == ".log")
    config = config_of(log, "vehicle.mass_max_kg=15000")
    notes = replay(log, config).warnings
    for sentences in (hints(log, config), notes):
        assert any("vehicle.mass_max_kg = 15,000 kg" in each for each in sentences), sentences
