"""Signals that go on and off: which roles do, and which signals of the bus may become such roles."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from canest.config.schema import Config
from canest.config.sections import Source
from canest.core.roles import ROLES
from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.bus_signals import Ranked

#: roles of the signal map that may switch a load and that the model does not use otherwise
SWITCH_ROLES = ("fan_speed", "pto_state")
#: a bus signal must explain this much of the remainder to be tried as a switch
TRY_SIGNAL_SHARE = 0.1
#: signals of the bus that are tried at most
MOST_TRIED = 5


def with_switches(config: Config, ranked: Sequence[Ranked]) -> Config:
    """Return the config with the best-ranked switching signals in its map (unchanged when there is none)."""
    new: dict[str, Source] = {}
    for r in ranked[:MOST_TRIED]:
        if r.switches and r.explained > TRY_SIGNAL_SHARE:
            new[_role_for(r.source, {*ROLES, *config.signals, *new})] = r.source
    if not new:
        return config
    return config.model_copy(update={"signals": config.signals | new})


def _role_for(source: Source, taken: Collection[str]) -> str:
    """Return a name for a signal's column: never a role that means something else to the model already."""
    name = (source.signal or source.column or "").lower()
    role = re.sub(r"\W+", "_", name).strip("_") or "signal"
    while role in taken:
        role = f"other_{role}"
    return role


def switching_roles(problem: Problem, roles: Sequence[str]) -> list[str]:
    """Return the roles among these that are both off and on for a while during the drives."""
    found = []
    for role in roles:
        values = np.concatenate(
            [p.run.signals.get(role, np.full(len(p.run.open), np.nan)) for p in problem.parts]
        )
        inside = np.concatenate([p.windows.index >= 0 for p in problem.parts])
        known = values[inside & np.isfinite(values)]
        if len(known) < 0.5 * inside.sum():
            continue
        low, high = np.percentile(known, [2, 98])
        share = float((known > 0.5 * (low + high)).mean()) if high > low else 0.0
        if 0.03 < share < 0.97:
            found.append(role)
    return found
