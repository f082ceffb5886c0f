"""The scenarios of the stress benchmark: each function gives one drive by its seed."""

from __future__ import annotations

from typing import Any

import numpy as np

from canest.simulation.run import simulate

Scenario = dict[str, Any]

PULSES: Scenario = {"kind": "pulses"}
SLIPSTREAM: Scenario = {"effect": "drafting", "reduction": 0.6, "period_s": 50.0}
MIXED: Scenario = {"kind": "mixed", "retarder": True}
LIGHT_KG, HEAVY_KG = (14000.0, 18000.0), (27000.0, 33000.0)
NIGHT_S = 8 * 3600
#: the one manoeuvre: when and how fast, how long; a throttle push is not cut short below the last speed
MANOEUVRE_S, MANOEUVRE_MPS, MANOEUVRE_M, FREE_MPS = 60.0, 21.0, 168.0, 30.0
#: phases of the manoeuvre, spread over so many metres
PHASES, PHASES_M = 9, 200.0
#: facts of a truck whose torque is stated as within 6 % (two standard deviations)
STATED_6_PCT: Scenario = {"torque_accuracy": 0.03}
_SHORT_STOPS = {"kind": "stop-and-go", "speeds_mps": [10.0, 15.0], "drive_s": [50, 80]}


def drawn(seed: int, span: tuple[float, float]) -> float:
    """Return a mass between two, kg, by the seed."""
    return float(round(np.random.default_rng(seed).uniform(*span), -2))


def truck(seed: int, **changes: Any) -> Scenario:
    """Return an ordinary drive of a truck with small undeclared errors, with some keys changed."""
    return {
        "seed": seed,
        "duration_s": 400,
        "vehicle": "class8",
        "mass_kg": drawn(seed, (12000, 34000)),
        "road": {"kind": "highway", "grade_max": 0.04},
        "driver": MIXED,
        "small_errors": True,
        "sensors": {"altitude_noise_m": 2.0},
    } | changes


def spreader(seed: int, rate_kgps: float, driver: Scenario) -> Scenario:
    """Lose mass all the time, from 24 to 30 t."""
    load = {"t_s": 0, "mass_kg": drawn(seed, (24000, 30000)), "rate_kgps": -rate_kgps}
    return truck(
        seed, duration_s=600, mass_kg=[load], driver=driver, road={"kind": "highway", "grade_max": 0.03}
    )


def town() -> Scenario:
    """Return a driver who stops too shortly for loading."""
    return {**_SHORT_STOPS, "stand_s": [3, 8]}


def changed_in_motion(seed: int, before: tuple[float, float], after: tuple[float, float]) -> Scenario:
    """Change the load at 200 s under a pulsating throttle, on flat road and on hills."""
    loads = [
        {"t_s": 0, "mass_kg": drawn(seed, before)},
        {"t_s": 200, "mass_kg": drawn(seed + 1, after), "moving": True},
    ]
    road = {"kind": "flat"} if seed % 2 else {"kind": "highway", "grade_max": 0.03}
    return truck(seed, duration_s=500, mass_kg=loads, driver=PULSES, road=road)


def changed_by_a_third(seed: int) -> Scenario:
    """Change the load in motion by a third, up and down, in ordinary driving on flat road and on hills."""
    light_kg = drawn(seed, (16000.0, 24000.0))
    before_kg, after_kg = light_kg, round(4.0 / 3.0 * light_kg, -2)
    if seed // 2 % 2:
        before_kg, after_kg = after_kg, before_kg
    drive = changed_in_motion(seed, (before_kg, before_kg), (after_kg, after_kg))
    return drive | {"driver": MIXED}


def changed_in_short_stop(seed: int) -> Scenario:
    """Change the load in a stop of 12 to 22 s, up and down."""
    before, after = (LIGHT_KG, HEAVY_KG) if seed % 2 else (HEAVY_KG, LIGHT_KG)
    loads = [{"t_s": 0, "mass_kg": drawn(seed, before)}, {"t_s": 250, "mass_kg": drawn(seed + 1, after)}]
    return truck(seed, duration_s=700, mass_kg=loads, driver={**_SHORT_STOPS, "stand_s": [12, 22]})


def stepped_road(seed: int) -> Scenario:
    """Drive over grades of up to 4.5 % that change within 2 m."""
    grades = np.random.default_rng(seed).uniform(-0.045, 0.045, 24).round(4).tolist()
    return truck(seed, road={"kind": "steps", "grades": grades, "length_m": 450.0})


def sine_road(seed: int, wavelength_m: float, driver: Scenario) -> Scenario:
    """Drive over hills of one wavelength."""
    return truck(seed, driver=driver, road={"kind": "sine", "amplitude": 0.03, "wavelength_m": wavelength_m})


def motorway(seed: int) -> Scenario:
    """Hold one speed on long gentle grades."""
    road = {"kind": "highway", "grade_max": 0.02, "stretch_m": [800, 2500]}
    return truck(seed, duration_s=700, road=road, driver=cruise(23.5, 20.0))


def slipstreams(seed: int, driver: Scenario) -> Scenario:
    """Drive behind a truck and alone by turns, 50 s each in the mean: 60 % of the drag comes and goes."""
    return motorway(seed) | {"driver": driver, "undeclared": [SLIPSTREAM]}


def cruise(speed_mps: float, start_mps: float, **more: Any) -> Scenario:
    """Return a driver who holds a speed, with the engine brake downhill."""
    return {"kind": "cruise", "speed_mps": speed_mps, "start_mps": start_mps, "retarder": True, **more}


def rough(rng: np.random.Generator, grade_rms: float = 0.015) -> Scenario:
    """Return a road with as much grade at every wavelength from 50 m to 3 km: a power law of the slope."""
    at_m = np.arange(0.0, 14000.0, 5.0)
    waves_m = np.geomspace(50.0, 3000.0, 24)
    phases = rng.uniform(0, 2 * np.pi, len(waves_m))
    waves = np.sin(2 * np.pi * at_m[:, None] / waves_m + phases).sum(1)
    grade = grade_rms * np.sqrt(2 / len(waves_m)) * waves
    return {"kind": "points", "at_m": at_m.tolist(), "grade": grade.round(5).tolist()}


def rough_road(seed: int) -> Scenario:
    """Drive over a rough road of 1.5 % RMS in all."""
    return truck(seed, road=rough(np.random.default_rng(seed)))


def looks_ahead(drive: Scenario, about_mps: float | None = None) -> Scenario:
    """Return the drive by one who gathers speed 250 m before a climb, and lets it go before the crest.

    about_mps: the speed on even road; None: as the given driver drives there.
    """
    first = simulate(drive).history
    t, distance, grade, speed = (first[k][::400] for k in ("t_s", "distance_m", "grade", "speed_mps"))
    ahead = np.interp(distance + 250.0, distance, grade)
    wanted = (speed if about_mps is None else about_mps) + np.clip(70.0 * (ahead - grade), -3.0, 3.0)
    driver = {"kind": "given", "firmness_1ps": 0.15, "retarder": True}
    driver |= {"start_mps": drive["driver"].get("start_mps", 0.0)}
    return drive | {"driver": {**driver, "at_s": t.tolist(), "speed_mps": wanted.round(2).tolist()}}


def looking_ahead(seed: int) -> Scenario:
    """Hold about 21 m/s, looking ahead."""
    return looks_ahead(truck(seed, driver=cruise(21.0, 19.0)), 21.0)


def with_effects(seed: int, *effects: Scenario, **changes: Any) -> Scenario:
    """Drive with larger undeclared effects than the small ones of every vehicle."""
    return truck(seed, undeclared=list(effects), **changes)


def reported_late(seed: int) -> Scenario:
    """Push and lift the throttle where torque acts 0.4 s before its report."""
    late = {"effect": "torque_delay", "delay_s": 0.4}
    sensors = {"altitude_noise_m": 2.0, "torque_delay_s": 0.0}
    return with_effects(seed, late, driver=PULSES, small_errors=False, sensors=sensors)


def one_manoeuvre(phase: int) -> Scenario:
    """Hold 21 m/s, push and lift the throttle twice within 168 m, hold 21 m/s; the phase moves it along."""
    begin = MANOEUVRE_S + phase % PHASES * PHASES_M / PHASES / MANOEUVRE_MPS
    pushes = [0.75, 0.0, 0.75, 0.0]
    lasts = MANOEUVRE_M / MANOEUVRE_MPS
    at = [begin + lasts * k / len(pushes) for k in range(len(pushes) + 1)]
    driver = {
        "kind": "given",
        "start_mps": MANOEUVRE_MPS,
        "fixed_gear": 10,
        "firmness_1ps": 0.2,
        "at_s": [0.0, begin - 0.01, *at],
        "speed_mps": [MANOEUVRE_MPS] * 2 + [FREE_MPS] * len(pushes) + [MANOEUVRE_MPS],
        "throttle": [None, None, *pushes, None],
    }
    seed = phase // PHASES
    mass = drawn(seed, (18000, 24000))
    return truck(seed, mass_kg=mass, duration_s=begin + 60, road={"kind": "flat"}, driver=driver)


def after_a_night(seed: int) -> tuple[Scenario, Scenario]:
    """Drive, be silent for eight hours, and drive away with another load."""
    evening = truck(seed, duration_s=300, driver=PULSES, mass_kg=drawn(seed, LIGHT_KG))
    start = {"start_s": 1_700_000_000 + 300 + NIGHT_S}
    return evening, truck(seed + 1, duration_s=100, driver=PULSES, mass_kg=drawn(seed, HEAVY_KG), bus=start)


#: what the other vehicles weigh, kg
OTHER_LOADS_KG = {"light-truck": (4000.0, 7500.0), "car": (1600.0, 2500.0), "electric-car": (1500.0, 2200.0)}


def other_vehicle(vehicle: str, seed: int) -> Scenario:
    """Drive another vehicle in country and town."""
    mass_kg = drawn(seed, OTHER_LOADS_KG[vehicle])
    return truck(seed, vehicle=vehicle, mass_kg=mass_kg, driver={"kind": "mixed"})


def behind_a_gateway(seed: int) -> Scenario:
    """Drive an older truck, whose speeds and gear come ten times a second through a gateway."""
    return truck(seed, bus={"j1587_gateway": True})
