"""The doctor names the line of the config that contradicts the log, in a person's words."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from canest.config import load_config
from canest.doctor.check import Doctor
from canest.doctor.consistency import ConsistencyCheck
from canest.doctor.gear_table import slipping_gears
from canest.logs import open_log
from tests.pulsing_truck import config_of, write_drive

RATIOS = "{1: 12.69, 2: 9.29, 3: 6.75, 4: 4.9, 5: 3.62, 6: 2.59, 7: 1.9, 8: 1.38, 9: 1.0, 10: 0.74}"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return write_drive(tmp_path_factory.mktemp("drive"), 150)


def hints(drive, *overrides, without=()):
    with open_log(drive) as log:
        doctor = Doctor(config_of(drive, *overrides, without=without))
        for block in log:
            doctor.push(block)
        return doctor.report().hints


@pytest.mark.parametrize(
    "without",
    [
        (),
        ("gear_ratio",),
        ("gear_ratio", "output_shaft_speed"),
        ("gear_ratio", "gear"),
        ("gear_ratio", "gear", "output_shaft_speed"),
        ("vehicle_speed",),
        ("engine_speed",),
    ],
)
def test_a_config_that_fits_gets_no_hint(drive, without):
    assert hints(drive, without=without) == []


def test_gears_of_another_gearbox(drive):
    (hint_text,) = hints(
        drive, f"vehicle.gear_ratios={RATIOS.replace('1.38', '1.62')}", without=("gear_ratio",)
    )
    assert "engine and output shaft turn in the ratio 1.38 in gear 8 (gear_ratios: 1.62)" in hint_text


def test_low_gears_in_which_the_engine_turns_too_fast_are_a_torque_converter(drive):
    table = RATIOS.replace("8: 1.38", "8: 1.31")
    (hint_text,) = hints(drive, f"vehicle.gear_ratios={table}", without=("gear_ratio",))
    assert "a torque converter that slips in low gears does that" in hint_text
    assert "another gearbox" not in hint_text


@pytest.mark.parametrize(
    ("times", "slip"),
    [
        ({1: 1.05, 2: 1.0, 3: 1.0}, [1]),
        ({1: 1.08, 2: 1.04, 3: 1.0}, [1, 2]),
        ({1: 1.0, 2: 1.05, 3: 1.0}, []),  # a lower gear fits
        ({1: 1.05, 2: 0.95, 3: 1.0}, []),
        ({1: 0.95, 2: 1.0}, []),  # no converter turns the engine slower
        ({1: 1.2, 2: 1.0}, []),
        ({1: 1.05, 2: 1.05}, []),
        ({1: 1.0}, []),
    ],
)
def test_which_gears_slip(times, slip):
    assert slipping_gears(times) == slip


def test_without_an_output_shaft_all_gears_off_alike_are_one_wheel_radius(drive):
    (hint_text,) = hints(drive, "vehicle.wheel_radius_m=0.56", without=("gear_ratio", "output_shaft_speed"))
    assert "engine and vehicle speed agree with wheel_radius_m 0.500" in hint_text
    assert "the config has 0.56" in hint_text


@pytest.mark.parametrize("factor", [0.85, 1.15])
def test_a_wrong_axle_shows_where_the_bus_has_the_ratio(drive, factor):
    """Ratio, engine and road speed: no gear table and no output shaft is needed."""
    (hint_text,) = hints(drive, f"vehicle.final_drive={3.73 * factor}", without=("output_shaft_speed",))
    assert "engine and vehicle speed agree with wheel_radius_m" in hint_text
    assert float(hint_text.split("or with final_drive ")[1].split()[0]) == pytest.approx(3.73, rel=0.01)


def test_a_ratio_that_is_mapped_and_never_sent_leaves_the_table_to_judge(drive, tmp_path):
    """Its message is not on this bus: gears of another gearbox are still named."""
    log = tmp_path / "no-etc2.log"
    log.write_text("\n".join(line for line in drive.read_text().splitlines() if "18F00503#" not in line))
    log.with_suffix(".yaml").write_text(drive.with_suffix(".yaml").read_text())
    assert len(log.read_bytes()) < len(drive.read_bytes())
    found = hints(log, "vehicle.final_drive=4.29", without=("output_shaft_speed",))
    assert any("engine and vehicle speed turn mostly in the ratio" in each for each in found), found


def test_an_engine_speed_twice_as_large_beside_an_output_shaft(drive):
    found = hints(drive, "signals.engine_speed.scale=2")
    assert any(each.startswith("engine_speed is 2 times what output shaft and gear_ratio") for each in found)


@pytest.mark.parametrize("factor", [2, 0.5, 8, 0.1])
@pytest.mark.parametrize("without", [("gear_ratio", "output_shaft_speed"), ("output_shaft_speed",)])
def test_a_speed_off_by_more_than_any_wheel_is_first_a_signal_misread(drive, factor, without):
    found = hints(drive, f"signals.engine_speed.scale={factor}", without=without)
    (hint_text,) = [each for each in found if "wheel_radius_m" in each]
    assert hint_text.startswith(
        f"engine_speed is {factor} times what vehicle_speed gives: are factor, start bit"
    )
    assert "Else engine and vehicle speed agree with wheel_radius_m" in hint_text


GEARLESS = ("gear_ratio", "gear", "output_shaft_speed")


@pytest.mark.parametrize(("radius_m", "final_drive"), [(0.56, 4.18), (0.45, 3.36)])
def test_without_a_gear_signal_the_table_is_tried_as_a_whole(drive, radius_m, final_drive):
    (hint_text,) = hints(drive, f"vehicle.wheel_radius_m={radius_m}", without=GEARLESS)
    assert "engine and vehicle speed turn mostly in the ratio" in hint_text
    radius, axle = (
        float(hint_text.split(word)[1].split()[0]) for word in ("wheel_radius_m ", "final_drive ")
    )
    assert radius == pytest.approx(0.5, rel=0.01)
    assert axle == pytest.approx(final_drive, rel=0.01)


def test_a_table_that_no_factor_mends(drive):
    (hint_text,) = hints(drive, "vehicle.gear_ratios={1: 8.0, 2: 1.2}", without=GEARLESS)
    assert "is the table another gearbox's" in hint_text


def test_a_wheel_radius_is_reported_once_for_all_road_speeds(drive):
    (hint_text,) = hints(drive, "vehicle.wheel_radius_m=0.56")
    assert "vehicle speed and output shaft agree with wheel_radius_m 0.500" in hint_text


@pytest.mark.parametrize(
    ("scale", "mistake"), [(3.6, "km/h is taken for m/s"), (1 / 3.6, "m/s is taken for km/h")]
)
@pytest.mark.parametrize("role", ["vehicle_speed", "undriven_speed"])
def test_a_speed_in_another_unit(drive, role, scale, mistake):
    (hint_text,) = hints(drive, f"signals.{role}.scale={scale}")
    assert mistake in hint_text and f"signals.{role}" in hint_text


@pytest.mark.parametrize("without", [("gear_ratio", "output_shaft_speed"), GEARLESS])
@pytest.mark.parametrize(
    ("scale", "mistake"),
    [
        (1.609, "km/h is taken for mph"),
        (2.237, "mph is taken for m/s"),
        (3.6, "km/h is taken for m/s"),
        (1 / 1.609, "mph is taken for km/h"),
        (1 / 2.237, "m/s is taken for mph"),
    ],
)
def test_a_speed_in_another_unit_against_the_engine(drive, scale, mistake, without):
    (hint_text,) = hints(drive, f"signals.vehicle_speed.scale={scale}", without=without)
    assert "signals.vehicle_speed" in hint_text and mistake in hint_text


@pytest.mark.parametrize("without", [(), ("output_shaft_speed",)])
def test_an_engine_speed_in_another_unit(drive, without):
    found = hints(drive, "signals.engine_speed.unit=rad/s", without=("gear_ratio", *without))
    assert any("rpm is taken for rad/s: look at the unit of signals.engine_speed" in h for h in found)
    assert not any("wheel_radius_m" in h for h in found)


def test_a_measured_table_holds_no_gear_that_was_not_measured(drive):
    shifted = "{7: 12.69, 8: 1.0, 9: 0.74, 10: 0.6}"
    found = hints(drive, f"vehicle.gear_ratios={shifted}", without=("gear_ratio",))
    (table,) = [h.split("gear_ratios: {")[-1] for h in found if "another gearbox" in h]
    assert "7: 12.69" not in table and "9: 1" in table and "10: 0.74" in table


@pytest.mark.parametrize("gears", [{}, {"vehicle.gear_ratios": "{1: 9.0}"}])
@pytest.mark.parametrize(("factor", "mistake"), [(1.0, ""), (1 / 0.44704, "mph is taken for m/s")])
def test_a_vehicle_of_one_gear_whose_speed_is_in_another_unit(factor, mistake, gears):
    keys = {"vehicle.gear_ratios": "{}", "vehicle.final_drive": 1.0 if gears else 9.0, **gears}
    config = load_config("class8", [f"{key}={value}" for key, value in keys.items()])
    signals = {role: config.signals[role] for role in ("engine_torque_pct", "engine_speed", "vehicle_speed")}
    judge = ConsistencyCheck(config.model_copy(update={"signals": signals}))
    t_us = np.arange(1000, dtype=np.int64) * 20_000
    speed = 15.0 + 5.0 * np.sin(t_us / 4e6)
    turns = 9.0 / config.vehicle.wheel_radius_m * 30 / np.pi
    judge.push({"engine_speed": (t_us, turns * speed), "vehicle_speed": (t_us, factor * speed)})
    hints = judge.hints()
    assert [mistake in hint for hint in hints] == ([True] if mistake else [])


@pytest.mark.parametrize("wild", ["1e308", "-1.7e308", "5e-324"])
def test_wild_numbers_warn_of_nothing_and_the_rest_is_judged(tmp_path, wild):
    """Warnings are errors here."""
    rows = ["t_s,rpm,v,tq"]
    for i in range(2000):
        speed = 15.0 + 5.0 * np.sin(i / 80)
        odd = [wild if i % 97 == k else None for k in (3, 50, 51)]
        rows.append(f"{i / 50},{odd[0] or 600 * speed},{odd[1] or speed / 0.44704},{odd[2] or 80 + i % 7}")
    (tmp_path / "wild.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "wild.yaml").write_text("""
vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 18.85, drag_area_m2: 0.7,
  rolling_resistance: 0.01}
dbc: []
signals:
  engine_torque: {column: tq, unit: kNm, scale: 0.001}
  engine_speed: {column: rpm, unit: rpm}
  vehicle_speed: {column: v, unit: m/s, period_s: 0.02}
""")
    doctor = Doctor(load_config(str(tmp_path / "wild.yaml")))
    with open_log(tmp_path / "wild.csv", columns=["rpm", "v", "tq"]) as log:
        for block in log:
            doctor.push(block)
    assert any("mph is taken for m/s" in hint for hint in doctor.report().hints)


def test_a_reference_torque_that_the_config_does_not_map(drive):
    wrong = "vehicle.reference_torque_Nm=1500"
    assert "2100 N m (used when received), the config has 1500" in hints(drive, wrong)[0]
    (hint_text,) = hints(drive, wrong, without=("reference_torque",))
    assert "2100 N m (not used: signals maps no reference_torque), the config has 1500" in hint_text
    assert hints(drive, without=("reference_torque",)) == []


def test_small_blocks_of_a_live_bus_give_the_same_report(drive):
    overrides = (f"vehicle.gear_ratios={RATIOS.replace('1.38', '1.62')}", "vehicle.wheel_radius_m=0.56")
    config = config_of(drive, *overrides, without=("gear_ratio",))
    live, whole = Doctor(config), Doctor(config)
    with open_log(drive) as log:
        for block in log:
            whole.push(block)
            for first in range(0, len(block), 40):
                live.push(block[first : first + 40])
    found = live.report()
    assert found.to_json() == whole.report().to_json()
    assert len(found.hints) == 2


def test_stamps_that_stand_still_do_not_pile_up():
    judge = ConsistencyCheck(load_config("class8"))
    stamps, rpm = np.zeros(1000, np.int64), np.full(1000, 1200.0)
    tracemalloc.start()
    for _ in range(1000):
        judge.push({"engine_speed": (stamps, rpm.copy()), "output_shaft_speed": (stamps, rpm.copy())})
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept_bytes < 2_000_000  # all of them: 16 MB
