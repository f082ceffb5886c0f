"""What `canest check` says of the rate of torque and speed, on a table at that rate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from canest.config.load import parse_config
from canest.config.schema import Config
from canest.core.errors import ConfigError
from canest.doctor.check import Doctor
from canest.logs.format_detection import open_log

VEHICLE: dict[str, Any] = {
    "mass_min_kg": 17_000,
    "mass_max_kg": 33_000,
    "wheel_radius_m": 0.5,
    "final_drive": 1.0,
    "drag_area_m2": 5.5,
    "rolling_resistance": 0.009,
}


def hints(tmp_path: Path, apart_s: float, **source: Any) -> tuple[list[str], list[str]]:
    rows = [f"{k * apart_s:.2f},{5000 + 10 * (k % 7)},{10 + 0.1 * (k % 5):.2f}" for k in range(60)]
    log = tmp_path / "slow.csv"
    log.write_text("\n".join(["t_s,force,speed", *rows]) + "\n")
    signals = {
        "wheel_force": {"column": "force", "stale_s": 20} | source,
        "vehicle_speed": {"column": "speed", "stale_s": 20} | source,
    }
    config = Config.model_validate(
        {"vehicle": VEHICLE, "dbc": [], "signals": signals, "sampling": {"hold_s": 10}}
    )
    check = Doctor(config)
    with open_log(log) as reader:
        for block in reader:
            check.push(block)
        report = check.report(reader)
    return report.hints, report.notes


def test_a_second_from_report_to_report_asks_for_a_period(tmp_path: Path) -> None:
    found = [h for h in hints(tmp_path, 1.0)[0] if "period_s: 1 " in h]
    assert [h.split(" ")[0] for h in found] == ["signals.wheel_force", "signals.vehicle_speed"]


def test_with_its_period_stated_only_the_delay_is_named(tmp_path: Path) -> None:
    found, notes = hints(tmp_path, 1.0, period_s=1.0)
    assert not any("period_s" in h for h in found)
    assert any("as it was 1.2 s ago" in note for note in notes)


def test_seven_seconds_are_too_seldom_whatever_is_stated(tmp_path: Path) -> None:
    assert sum("too seldom" in h for h in hints(tmp_path, 7.0)[0]) == 2


@pytest.mark.parametrize("period_s", [7.0, 0.0])
def test_a_period_beyond_what_can_be_joined_is_refused(period_s: float) -> None:
    text = (
        "vehicle: {mass_min_kg: 1000, mass_max_kg: 2000, wheel_radius_m: 0.3, final_drive: 1, "
        "drag_area_m2: 1, rolling_resistance: 0.01}\ndbc: []\nsignals:\n  wheel_force: {column: a}\n"
        f"  vehicle_speed: {{column: b, period_s: {period_s}}}\n"
    )
    with pytest.raises(ConfigError, match="period_s"):
        parse_config(text, "slow.yaml")
