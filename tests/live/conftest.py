"""One simulated drive for all live tests, and the real logs."""

from __future__ import annotations

from pathlib import Path

import pytest

DATA = Path(__file__).resolve().parent.parent / "data"


@pytest.fixture(scope="session")
def data():
    return DATA


@pytest.fixture(scope="session")
def drive():
    """A minute and a half of the demonstration drive: the mass is valid after half a minute."""
    from canest.simulation.reading import load_scenario
    from canest.simulation.run import simulate

    scenario = load_scenario("demo")
    return simulate(scenario.model_copy(update={"duration_s": 90.0})).frames
