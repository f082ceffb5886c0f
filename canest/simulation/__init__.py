"""A truth simulator: road, driver, vehicle and bus, richer than the estimators' model and apart from it.

No equation is shared with `canest.vehicle`: an error there must show against a drive made here.
"""

from __future__ import annotations

from canest.simulation.drive import SimulatedDrive
from canest.simulation.reading import load_scenario, shipped_scenarios
from canest.simulation.run import simulate, simulate_to_directory
from canest.simulation.scenario import Scenario

__all__ = [
    "Scenario",
    "SimulatedDrive",
    "load_scenario",
    "shipped_scenarios",
    "simulate",
    "simulate_to_directory",
]
