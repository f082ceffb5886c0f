"""The config that an engineer would write for a simulated vehicle: its data sheet, and its signal map."""

from __future__ import annotations

from typing import Any

import yaml

from canest.simulation.scenario import Scenario
from canest.simulation.vehicles import VehicleSpec
from canest.system.shipped_files import find

#: range of masses that an owner would give, beyond those of the drive
LIGHTER, HEAVIER = 0.6, 1.8  # chosen
ROOM_BELOW = 1.1  #: a range of masses that begins nearer than this below the lightest is replaced (chosen)


_RECEIVER = {
    "latitude": {"message": "VP1", "signal": "Latitude", "source": 0x1C},
    "longitude": {"message": "VP1", "signal": "Longitude", "source": 0x1C},
}


def known_config(scenario: Scenario) -> dict[str, Any]:
    """Return the config (schema of `canest.config`) with what is declared of the scenario, and no more.

    The signal map is that of the shipped config for the same bus.
    """
    shipped = "testcar" if scenario.vehicle.layout == "car" else "class8"
    if scenario.bus.j1587_gateway:
        shipped = "class8-j1587"
    config: dict[str, Any] = yaml.safe_load(find("configs", shipped).read_text(encoding="utf-8"))
    if scenario.positions is not None:
        config["dbc"] = list(dict.fromkeys([*config["dbc"], "j1939.dbc"]))
        config["signals"] |= _RECEIVER
    declared = config["vehicle"]
    declared.pop("key", None)
    declared.update(_data_sheet(scenario.vehicle))
    declared["name"] = scenario.title or "simulated vehicle"
    lightest, heaviest = scenario.mass_range_kg
    if not declared["mass_min_kg"] * ROOM_BELOW < lightest <= heaviest < declared["mass_max_kg"]:
        declared["mass_min_kg"] = round(lightest * LIGHTER)
        declared["mass_max_kg"] = round(heaviest * HEAVIER)
    return config


def _data_sheet(vehicle: VehicleSpec) -> dict[str, Any]:
    gears = range(1, len(vehicle.gear_ratios) + 1)
    usual = max(set(vehicle.gear_efficiencies), key=vehicle.gear_efficiencies.count)
    facts: dict[str, Any] = {
        "wheel_radius_m": vehicle.wheel_radius_m,
        "wheel_inertia_kgm2": vehicle.wheel_inertia_kgm2,
        "final_drive": vehicle.final_drive,
        "gear_ratios": dict(zip(gears, vehicle.gear_ratios, strict=True)),
        "driveline_efficiency": usual,
        "gear_efficiency": {
            gear: value
            for gear, value in zip(gears, vehicle.gear_efficiencies, strict=True)
            if value != usual
        },
        "engine_inertia_kgm2": vehicle.engine_inertia_kgm2,
        "drag_area_m2": vehicle.cda_m2,
        "air_density_kgpm3": vehicle.air_density_kgpm3,
        "rolling_resistance": vehicle.crr,
        "accelerometer": {"pitch_rad_per_mps2": vehicle.pitch_rad_per_mps2},
    }
    if vehicle.layout == "j1939":
        facts["reference_torque_Nm"] = vehicle.reference_torque_Nm
        facts["retarder"] = {"reference_torque_Nm": vehicle.retarder_Nm, "location": "crank"}
    return facts
