"""A mass in tonnes where kilograms are asked for is refused alike, wherever it is given."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

import canest
from canest.cli.options import MASS
from canest.config import load_config
from canest.core.errors import CanestError
from canest.core.masses import LEAST_MASS_KG

LOG = Path(__file__).parents[1] / "data" / "kenworth" / "normal.log.xz"
IN_TONNES = LEAST_MASS_KG - 1


@pytest.mark.parametrize(
    "give",
    [
        lambda: MASS.convert(IN_TONNES, None, None),
        lambda: canest.replay(LOG, "kenworth", mass_kg=IN_TONNES),
        lambda: load_config("kenworth", [f"vehicle.mass_min_kg={IN_TONNES}"]),
    ],
    ids=["command line", "function", "config"],
)
def test_a_mass_below_the_least_is_refused_with_that(give):
    with pytest.raises((CanestError, click.BadParameter), match=rf"\b{LEAST_MASS_KG}\b"):
        give()
