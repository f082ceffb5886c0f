"""What the DBC makes of a number: a unit that nobody states, one that does not fit, a factor of 0."""

from __future__ import annotations

import json

import pytest

import canest as api
from canest.config import load_config
from canest.doctor.config_warnings import config_warnings
from canest.pipeline.signal_map import wants_of
from canest.system.shipped_files import shipped

VEHICLE = """
vehicle: {mass_min_kg: 800, mass_max_kg: 5000, wheel_radius_m: 0.34, final_drive: 9.0, drag_area_m2: 2.0,
  rolling_resistance: 0.01}
"""
TABLE = """dbc: []
signals:
  engine_torque: {column: tq, unit: Nm}
  vehicle_speed: {column: v%s}
  brake_switch: {column: brk}
  accelerator: {column: pedal}
"""
DBC = """VERSION ""
BU_: X
BO_ 257 MOT: 8 X
 SG_ Torque : 0|16@1- (0.1,0) [0|0] "Nm" X
 SG_ Speed : 16|16@1+ (0.01,0) [0|0] "UNIT" X
 SG_ Brake : 32|1@1+ (1,0) [0|1] "" X
"""
FRAMES = """dbc: [van.dbc]
signals:
  engine_torque: {message: MOT, signal: Torque}
  vehicle_speed: {message: MOT, signal: Speed%s}
  brake_switch: {message: MOT, signal: Brake}
"""


def table(tmp_path, more=""):
    path = tmp_path / "van.yaml"
    path.write_text(VEHICLE + TABLE % more)
    return path


def frames(tmp_path, unit, more=""):
    (tmp_path / "van.dbc").write_text(DBC.replace("UNIT", unit))
    path = tmp_path / "van.yaml"
    path.write_text(VEHICLE + FRAMES % more)
    return path


def test_check_replay_and_compare_name_a_column_without_a_unit(canest, tmp_path):
    config, log = table(tmp_path), tmp_path / "van.csv"
    log.write_text("t_s,v,tq,brk,pedal\n" + "".join(f"{i / 10},{i / 20},80,0,30\n" for i in range(300)))
    note = "no unit of the column: v is taken as m/s (state signals.vehicle_speed.unit)"
    assert note in canest("check", "-c", config).out
    assert note in canest("check", "-c", config, log).out
    assert note in json.loads(canest("replay", log, "-c", config, "--json", "-").out)["notes"]
    compared = canest("compare", log, "-c", config, "--mass", 1500, "--only", "rls", "--json", "-")
    assert note in json.loads(compared.out)["notes"]


def test_a_dbc_signal_without_a_unit_is_named(tmp_path):
    (note,) = config_warnings(load_config(frames(tmp_path, "")))
    assert note == "no unit in the DBC: MOT.Speed is taken as m/s (state signals.vehicle_speed.unit)"
    assert not config_warnings(load_config(frames(tmp_path, "km/h")))


@pytest.mark.parametrize("more", [", unit: mph", ", scale: 0.2778", ", map: {0: 0, 1: 5}"])
def test_a_conversion_of_the_config_is_enough(tmp_path, more):
    assert not config_warnings(load_config(table(tmp_path, more)))
    assert not config_warnings(load_config(frames(tmp_path, "", more)))


def test_a_scale_that_turns_a_sign_states_no_unit(tmp_path):
    assert len(config_warnings(load_config(table(tmp_path, ", scale: -1")))) == 1


@pytest.mark.parametrize("name", sorted(path.stem for path in shipped("configs").glob("*.yaml")))
def test_shipped_configs_need_no_note(name):
    assert not config_warnings(load_config(name))


def test_columns_that_bear_the_names_of_roles_are_in_their_units():
    vehicle = load_config("class8", ["vehicle.gear_ratios={}"]).vehicle
    rows = {"t_s": [0.0, 0.1, 0.2], "engine_torque": [1.0, 2.0, 3.0], "vehicle_speed": [1.0, 2.0, 3.0]}
    assert not any("unit" in note for note in api.estimate(rows, vehicle).summary["notes"])


def test_a_factor_of_zero_is_refused(canest, tmp_path):
    config = frames(tmp_path, "km/h")
    database = tmp_path / "van.dbc"
    database.write_text(database.read_text().replace("(0.1,0)", "(0,0)"))
    done = canest("check", "-c", config)
    assert done.code == 2 and "signals.engine_torque" in done.err and "MOT.Torque with factor 0" in done.err
    config.write_text(config.read_text().replace("signal: Torque", "signal: Torque, map: {0: 0, 1: 50}"))
    assert canest("check", "-c", config).code == 0


@pytest.mark.parametrize(("unit", "stated"), [("kmh", "km/h"), ("Mph", "mph"), ("bar", "")])
def test_a_unit_of_the_dbc_that_does_not_fit_names_the_key_that_overrides_it(canest, tmp_path, unit, stated):
    done = canest("check", "-c", frames(tmp_path, unit))
    assert (
        done.code == 2 and f"unit of MOT.Speed in the DBC does not fit the role, found '{unit}'" in done.err
    )
    assert f"unit: {stated} in this entry".replace("  ", " ") + " overrides the DBC's" in done.err
    assert canest("check", "-c", frames(tmp_path, unit, f", unit: {stated or 'mph'}")).code == 0


def test_a_unit_of_another_dimension_in_the_config_is_not_the_dbcs(canest, tmp_path):
    done = canest("check", "-c", frames(tmp_path, "km/h", ", unit: bar"))
    assert done.code == 2 and "unit does not fit the role, found 'bar'" in done.err
    assert "DBC" not in done.err


def test_blanks_around_a_unit_do_not_count(tmp_path):
    mine, other = (
        load_config(frames(tmp_path, " km/h ")),
        load_config(frames(tmp_path, "", ", unit: 'km/h '")),
    )
    for config in (mine, other):
        assert wants_of(config)["vehicle_speed"].factor == pytest.approx(1 / 3.6)


@pytest.mark.parametrize("numbers", ["1e300,0", "1e-300,0", "0.1,1e300"])
def test_a_factor_or_an_offset_that_no_quantity_has_is_refused(canest, tmp_path, numbers):
    config = frames(tmp_path, "km/h")
    database = tmp_path / "van.dbc"
    database.write_text(database.read_text().replace("(0.1,0)", f"({numbers})"))
    done = canest("check", "-c", config)
    assert done.code == 2 and "signals.engine_torque" in done.err and "Warning" not in done.err
    factor, offset = numbers.replace("e3", "e+3").split(",")
    assert f"MOT.Torque with factor {factor} and offset {offset}" in done.err
