"""Which faults of an ordinary size this data does not rule out, beside what was found.

That nothing was found of an effect may mean that it is not there, or that this drive cannot show it: a steady
force of its size may be the wind, or an error of the grade's reference.
"""

from __future__ import annotations

import numpy as np

from canest.core.frames import FloatColumn
from canest.diagnosis.search.evidence import Evidence
from canest.diagnosis.search.set_search import Search

#: an effect is ruled out where its value and so many standard deviations stay below an ordinary fault
RULED_OUT_SIGMAS = 2.0


def not_excluded(search: Search) -> list[str]:
    """Return the effects that may be there in the size of an ordinary fault, each once.

    Neither those that were chosen, nor their equivalents. Small errors of vehicle and reference are free
    within their spreads, the chosen effects without bounds.
    """
    if search.prior is None:
        return []
    problem, prior = search.problem, search.prior
    residual, columns = search.current()
    evidence = Evidence(search.small_errors(), problem.beside_nuisance(columns), prior.noise, 1.0)
    named = {c.candidate.effect for c in search.chosen}
    named |= {e.effect for c in search.chosen for e in c.equivalent}
    found = []
    for c, column in search.offered:
        if c.effect in named or c.effect in found or c.confounded or c.is_delay or not np.isfinite(c.scale):
            continue
        ordinary = c.info.fault_std(problem.parts[0].drive.config.vehicle)
        own, pull = _seen(evidence, residual, column)
        if c.scale < ordinary:  # measured
            own += prior.noise / c.scale**2
        if own <= 0.0:
            found.append(c.effect)
            continue
        value, std = -pull / own, float(np.sqrt(prior.noise / own))
        # an ordinary fault in either direction that a vehicle can have
        ends = [ordinary * sign for sign in (1.0, -1.0) if c.possible(ordinary * sign)]
        if any(np.sign(end) * (end - value) < RULED_OUT_SIGMAS * std for end in ends):
            found.append(c.effect)
    return found


def _seen(evidence: Evidence, residual: FloatColumn, column: FloatColumn) -> tuple[float, float]:
    """Return what small errors and choices leave of a regressor, squared, and its part of the residual."""
    whole = np.column_stack([residual, column])
    products = evidence.products(whole, whole)
    own = float(products[1, 1])
    if own < 1e-6 * float(column @ column):
        return 0.0, 0.0
    return own, float(products[0, 1])
