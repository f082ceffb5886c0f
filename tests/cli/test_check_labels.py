"""What the labels of a gear count as, whatever the byte order, and that a proposed map loses none."""

from __future__ import annotations

import numpy as np
import pytest

from canest.config import parse_config, read_databases
from canest.core.frames import FrameBlock
from canest.doctor.check import Doctor

DBC = """VERSION ""
BU_: X
BO_ 416 Gearbox: 8 X
 SG_ Gear{gear} (1,0) [0|15] "" X
 SG_ Page{page} (1,0) [0|15] "" X
 SG_ Wheel : 16|16@1+ (0.01,0) [0|0] "km/h" X
 SG_ Torque : 32|16@1+ (0.1,0) [0|0] "Nm" X
VAL_ 416 Gear 0 "Neutral" 1 "First" 2 "Second" 13 "Reverse" 15 "SNA" ;
"""
CONFIG = """
vehicle: {{mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 4, drag_area_m2: 0.7,
  rolling_resistance: 0.01, gear_ratios: {{1: 3.5, 2: 2.0}}}}
dbc: [{dbc}]
signals:
  gear: {{message: Gearbox, signal: Gear}}
  vehicle_speed: {{message: Gearbox, signal: Wheel}}
  engine_torque: {{message: Gearbox, signal: Torque}}
"""


def report(tmp_path, numbers, gear, page, words):
    (tmp_path / "car.dbc").write_text(DBC.format(gear=gear, page=page))
    doctor = Doctor(read_databases(parse_config(CONFIG.format(dbc=tmp_path / "car.dbc"))))
    n = len(numbers)
    stamps, ids, lengths = np.arange(n) * 20_000, np.full(n, 416, np.uint32), np.full(n, 8, np.uint8)
    doctor.push(FrameBlock(stamps, ids, lengths, words))
    return doctor.report()


LAYOUTS = {
    "little endian": (" : 0|4@1+", " : 4|4@1+", lambda numbers: numbers),
    "big endian": (" : 7|4@0+", " : 3|4@0+", lambda numbers: numbers << np.uint64(4)),
    "one of two pages": (" m5 : 0|4@1+", " M : 4|4@1+", lambda numbers: numbers | np.uint64(0x50)),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_numbers_that_count_are_shown_in_every_layout(tmp_path, layout):
    gear, page, words = LAYOUTS[layout]
    numbers = np.array([0, 1, 2, 15] * 20, np.uint64)
    found = report(tmp_path, numbers, gear, page, words(numbers))
    labels = next(role.labels for role in found.roles if role.role == "gear")
    assert {label.raw: label.value for label in labels} == {0: 0.0, 1: 1.0, 2: 2.0, 15: None}
    assert not [hint for hint in found.hints if "map:" in hint]


def test_a_map_that_is_proposed_keeps_the_gears_whose_labels_say_no_number(tmp_path):
    gear, page, words = LAYOUTS["big endian"]
    numbers = np.array([0, 1, 2, 13] * 20, np.uint64)
    (hint,) = [h for h in report(tmp_path, numbers, gear, page, words(numbers)).hints if "map:" in h]
    assert "reads 13 for 'Reverse'" in hint
    assert hint.endswith("paste map: {Neutral: 0, First: 1, Second: 2, Reverse: -1}")
