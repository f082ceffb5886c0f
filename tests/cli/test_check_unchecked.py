"""What no signal confirms is said, with the one that could: of the same motor first, and only if it came."""

from __future__ import annotations

import pytest

from canest.config import load_config
from canest.doctor.check import Doctor
from canest.doctor.config_warnings import config_warnings
from canest.doctor.missing_signals import missing_signal_warnings
from canest.logs.memory import FrameLog
from canest.offline.replay import replay
from tests.pulsing_truck import config_of as truck
from tests.pulsing_truck import write_drive
from tests.van_bus import BOTH, DBC, REAR, SPEED_MPS, TORQUE_NM, bus, config_of, report

TORQUE = REAR.splitlines(keepends=True)[0]


def unchecked(notes):
    return [note for note in notes if "nothing shows whether" in note]


def test_the_speed_beside_the_torque_is_proposed_before_another_motors(tmp_path):
    (note,) = unchecked(config_warnings(config_of(tmp_path, TORQUE)))
    assert note.startswith("no signals.engine_speed") and note.endswith("(MCU_R.MotR_Speed could)")


def test_no_speed_is_proposed_that_the_log_has_not(tmp_path):
    config = config_of(tmp_path, TORQUE, DBC.replace("MotR_Speed", "Wheel"))
    (note,) = unchecked(config_warnings(config))
    assert note.endswith("(MCU_F.MotF_Speed could)")
    assert unchecked(report(config, bus()).notes) == [note]
    assert unchecked(replay(FrameLog(bus()), config).summary["notes"]) == [note]
    assert not unchecked(report(config, bus(front_Nm=None)).notes)
    assert not unchecked(replay(FrameLog(bus(front_Nm=None)), config).summary["notes"])


def test_torques_at_the_wheels_need_a_speed_that_turns_with_them(tmp_path):
    (note,) = unchecked(report(config_of(tmp_path, BOTH), bus()).notes)
    assert note.startswith(
        "no signals.output_shaft_speed: nothing shows whether wheel_radius_m and the unit of"
    )
    assert note.endswith("(MCU_F.MotF_Speed could, with scale: final_drive / its ratio to the wheels)")
    shaft = "  output_shaft_speed: {message: MCU_R, signal: MotR_Speed, scale: 0.0943396}\n"
    for more in (shaft, REAR.splitlines(keepends=True)[1]):
        found = report(config_of(tmp_path, BOTH + more), bus(radius_m=0.387))
        assert not unchecked(found.notes)
        assert [hint for hint in found.hints if "agree with wheel_radius_m 0.387" in hint]


def test_the_speed_of_an_engine_with_gears_does_not_turn_with_the_wheels(tmp_path):
    dbc = DBC.replace("MotF_Speed", "EngSpeed").replace("MotR_Speed", "FanSpeed")
    assert not unchecked(config_warnings(config_of(tmp_path, BOTH, dbc)))


def unconfirmed(notes):
    return [note for note in notes if "confirms" in note]


def test_a_reference_torque_that_nothing_confirms_is_said_with_what_the_engine_gave(tmp_path):
    """The numbers of N m on this bus are taken as percent of 400 N m."""
    percent = REAR.replace("engine_torque:", "engine_torque_pct:").replace("Torque}", "Torque, unit: '%'}")
    config = config_of(tmp_path, percent)
    (note,) = unconfirmed(report(config, bus()).notes)
    assert note.startswith("nothing here confirms vehicle.reference_torque_Nm = 400, and masses are as wrong")
    assert unconfirmed(replay(FrameLog(bus()), config).summary["notes"]) == [note]
    torque_Nm, power_kW = (float(note.split(f" {unit}")[0].split()[-1]) for unit in ("N m", "kW"))
    assert torque_Nm == pytest.approx(4.0 * TORQUE_NM.max(), rel=0.02)
    motor_radps = 10.6 / 0.358 * SPEED_MPS
    most_kW = 4e-3 * (TORQUE_NM * motor_radps).max()
    assert 0.9 * most_kW < power_kW < most_kW  # held for a second
    doctor, frames = Doctor(config), bus()
    for first in range(0, len(frames), 40):
        doctor.push(frames[first : first + 40])
    assert unconfirmed(doctor.report().notes) == [note]
    net = config.model_copy(update={"vehicle": config.vehicle.model_copy(update={"friction_torque_pct": 20})})
    assert f"up to {torque_Nm - 80:.0f} N m" in unconfirmed(report(net, bus()).notes)[0]


def test_torques_in_newton_metres_and_buses_of_j1939_need_no_reference(tmp_path):
    assert not unconfirmed(report(config_of(tmp_path, REAR), bus()).notes)
    drive = write_drive(tmp_path, 30)
    for without in ((), ("reference_torque",)):
        config = truck(drive, without=without)
        assert not unconfirmed(replay(drive, config).summary["notes"])


def test_a_net_torque_is_told_from_one_that_lacks_the_friction():
    (hint,) = [h for h in missing_signal_warnings(load_config("class8"), ()) if "friction" in h]
    assert "0 of an electric motor and of a net torque, as one that is clearly negative in overrun" in hint
    stated = load_config("class8", ["vehicle.friction_torque_pct=0"])
    assert not [h for h in missing_signal_warnings(stated, ()) if "friction" in h]
