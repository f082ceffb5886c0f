"""Numbers in a config are those of YAML 1.2, as people write them."""

from __future__ import annotations

import pytest
import yaml

from canest.config import parse_config
from canest.config.yaml_loader import LOADER
from tests.config.test_mistakes import TRUCK, refused


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("02100", 2100), ("-007", -7), ("1_000", 1000), ("0x10", 16), ("0o17", 15), ("0b11", 3), ("+4", 4),
        ("1e3", 1000.0), ("1.5e-3", 0.0015), ("-.5", -0.5), ("3.", 3.0), ("010.5", 10.5), ("08", 8),
        ("50:00", "50:00"), ("1:30.5", "1:30.5"), ("e3", "e3"), ("-", "-"), (".", "."), ("0x", "0x"),
    ],
)  # fmt: skip
def test_a_number_is_what_it_looks_like(text, number):
    found = yaml.load(f"[{text}]" if text != "-" else '["-"]', Loader=LOADER)[0]
    assert found == number and type(found) is type(number)


def test_a_torque_with_a_zero_before_it_is_no_octal():
    text = TRUCK.replace("reference_torque_Nm: 2100", "reference_torque_Nm: 02100")
    assert text != TRUCK
    assert parse_config(text).vehicle.reference_torque_Nm == 2100
    assert (
        parse_config(TRUCK, overrides=["vehicle.reference_torque_Nm=02500"]).vehicle.reference_torque_Nm
        == 2500
    )


def test_gears_with_a_zero_before_them_count_in_tens():
    config = parse_config(TRUCK, overrides=["vehicle.gear_ratios={08: 1.38, 09: 1.0, 010: 0.74}"])
    assert config.vehicle.gear_ratios == {8: 1.38, 9: 1.0, 10: 0.74}


def test_the_same_gear_in_two_spellings_is_given_twice():
    text = TRUCK.replace(
        "signals:\n", "signals:\n  selected_gear: {message: A, signal: B, map: {08: 1, 8: 2}}\n"
    )
    assert "key given twice: signals.selected_gear.map.8" in refused(text)
