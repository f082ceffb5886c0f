"""Sets of effects with fitted values: which one is taken, and how uncertain the others make its values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from canest.diagnosis.search.choice import Chosen

#: of sets this close the commonest is taken: odds below 3 are not worth a mention
NO_DIFFERENCE = 2.0


@dataclass
class FittedSet:
    """A set of effects with fitted values, beside the reporting delay, and its criterion."""

    chosen: list[Chosen]
    criterion: float
    price: float  #: the criterion, with what taking so many effects of so many costs

    @property
    def names(self) -> tuple[str, ...]:
        """Return the effects' names, each once."""
        return tuple(dict.fromkeys(c.candidate.effect for c in self.chosen))

    def has_effects_of(self, chosen: Sequence[Chosen]) -> bool:
        """Return whether its effects are those of a choice, the reporting delay apart."""
        return set(self.names) == {c.candidate.effect for c in chosen if not c.candidate.is_delay}


def commonest(fitted: Sequence[FittedSet]) -> FittedSet:
    """Return, of the sets as good as the best one and not larger, the commonest."""
    best = min(fitted, key=lambda f: f.price)
    near = [
        f
        for f in fitted
        if f.price <= best.price + NO_DIFFERENCE
        and len(f.chosen) == len(best.chosen)
        and all(c.candidate.possible(c.deviation) for c in f.chosen)
    ]
    return min(near or [best], key=lambda f: sum(c.candidate.rarity for c in f.chosen))


def widen_by_rivals(chosen: Sequence[Chosen], rivals: Sequence[FittedSet], best: float) -> None:
    """Widen every standard deviation by how far the value is another one in sets that are as likely.

    best: the smallest criterion of all sets.
    """
    for c in chosen:
        weight, spread = 0.0, 0.0
        for rival in rivals:
            for other in rival.chosen:
                if other.candidate.label == c.candidate.label:
                    likely = float(np.exp(-0.5 * (rival.criterion - best)))
                    weight += likely
                    spread += likely * (other.deviation - c.deviation) ** 2
        if weight:
            c.std = float(np.hypot(c.std, np.sqrt(spread / weight)))
