"""The config that an engineer would write for a simulated vehicle: its data sheet, and its signal map."""

from __future__ import annotations

from typing import Any

from canest.simulate.scenario import Scenario


def known_config(scenario: Scenario) -> dict[str, Any]:
    """Return the config (schema of `canest.config`) with what is declared of the scenario, no more."""
    vehicle = scenario.vehicle
    masses = [change.mass_kg for change in scenario.mass_kg]
    gears = range(1, len(vehicle.gear_ratios) + 1)
    truck = vehicle.layout == "j1939"
    facts: dict[str, Any] = {
        "name": scenario.title or "simulated vehicle",
        "mass_min_kg": 7000.0 if truck and min(masses) > 7000 else round(min(masses) * 0.6, -2),
        "mass_max_kg": 40000.0 if truck and max(masses) > 12000 else round(max(masses) * 1.8, -2),
        "wheel_radius_m": vehicle.wheel_radius_m,
        "wheel_inertia_kgm2": vehicle.wheel_inertia_kgm2,
        "final_drive": vehicle.final_drive,
        "gear_ratios": dict(zip(gears, vehicle.gear_ratios, strict=True)),
        "driveline_efficiency": vehicle.gear_efficiencies[0],
        "gear_efficiency": dict(zip(gears, vehicle.gear_efficiencies, strict=True)),
        "engine_inertia_kgm2": vehicle.engine_inertia_kgm2,
        "drag_area_m2": vehicle.cda_m2,
        "air_density_kgpm3": vehicle.air_density_kgpm3,
        "rolling_resistance": vehicle.crr,
        "accelerometer": {"pitch_rad_per_mps2": vehicle.pitch_rad_per_mps2},
    }
    if truck:
        facts["reference_torque_Nm"] = vehicle.reference_torque_Nm
        if vehicle.retarder_Nm:
            facts["retarder"] = {"reference_torque_Nm": vehicle.retarder_Nm, "location": "crank"}
        return {"vehicle": facts, "dbc": ["j1939.dbc"], "signals": _truck_signals()}
    return {"vehicle": facts, "dbc": ["testcar.dbc"], "signals": _car_signals()}


def _truck_signals() -> dict[str, Any]:
    engine, gearbox, brakes, retarder, telematics = 0x00, 0x03, 0x0B, 0x0F, 0x1C
    table: dict[str, tuple[str, str, int]] = {
        "engine_torque_pct": ("EEC1", "ActualEngPercentTorque", engine),
        "engine_friction_pct": ("EEC3", "NominalFrictionPercentTorque", engine),
        "reference_torque": ("EC1", "EngReferenceTorque", engine),
        "engine_speed": ("EEC1", "EngSpeed", engine),
        "accelerator": ("EEC2", "AccelPedalPos1", engine),
        "output_shaft_speed": ("ETC1", "Trans1OutputShaftSpeed", gearbox),
        "input_shaft_speed": ("ETC1", "Trans1InputShaftSpeed", gearbox),
        "shift_in_process": ("ETC1", "TransShiftInProcess", gearbox),
        "driveline_engaged": ("ETC1", "TransDrivelineEngaged", gearbox),
        "clutch_slip": ("ETC1", "PercentClutchSlip", gearbox),
        "gear": ("ETC2", "TransCurrentGear", gearbox),
        "gear_ratio": ("ETC2", "TransActualGearRatio", gearbox),
        "vehicle_speed": ("CCVS1", "WheelBasedVehicleSpeed", engine),
        "brake_switch": ("CCVS1", "BrakeSwitch", engine),
        "brake_pedal": ("EBC1", "BrakePedalPos", brakes),
        "undriven_speed": ("EBC2", "FrontAxleSpeed", brakes),
        "retarder_torque_pct": ("ERC1", "ActualRetarderPercentTorque", retarder),
        "longitudinal_accel": ("VDC2", "LongitudinalAcceleration", brakes),
        "lateral_accel": ("VDC2", "LateralAcceleration", brakes),
        "yaw_rate": ("VDC2", "YawRate", brakes),
        "altitude": ("VDS", "Altitude", telematics),
        "ambient_temperature": ("AMB", "AmbientAirTemp", engine),
        "barometric_pressure": ("AMB", "BarometricPressure", engine),
        "fan_speed": ("FD", "EstPercentFanSpeed", engine),
    }
    return {
        role: {"message": message, "signal": signal, "source": source}
        for role, (message, signal, source) in table.items()
    }


def _car_signals() -> dict[str, Any]:
    table = {
        "engine_torque": ("CarEngine", "EngineTorque"),
        "engine_speed": ("CarEngine", "EngineSpeed"),
        "accelerator": ("CarEngine", "AcceleratorPedal"),
        "half_shaft_torque_left": ("CarHalfShafts", "HalfShaftTorqueLeft"),
        "half_shaft_torque_right": ("CarHalfShafts", "HalfShaftTorqueRight"),
        "undriven_speed": ("CarWheels", "RearAxleSpeed"),
        "vehicle_speed": ("CarWheels", "FrontAxleSpeed"),
        "output_shaft_speed": ("CarGearbox", "OutputShaftSpeed"),
        "gear": ("CarGearbox", "Gear"),
        "gear_ratio": ("CarGearbox", "GearRatio"),
        "shift_in_process": ("CarGearbox", "ShiftInProcess"),
        "driveline_engaged": ("CarGearbox", "DrivelineEngaged"),
        "brake_switch": ("CarBrakes", "BrakeSwitch"),
        "longitudinal_accel": ("CarMotion", "LongitudinalAccel"),
        "lateral_accel": ("CarMotion", "LateralAccel"),
        "yaw_rate": ("CarMotion", "YawRate"),
        "altitude": ("CarPosition", "Altitude"),
    }
    return {
        role: {"message": message, "signal": signal, "validity": "full"}
        for role, (message, signal) in table.items()
    }
