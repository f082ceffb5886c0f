"""Every effect that was tried, with what it is worth: the list of a diagnosis, best first."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from canest.diagnosis.run import Diagnosis
from canest.diagnosis.search.candidates import Candidate
from canest.diagnosis.search.choice import Chosen
from canest.diagnosis.search.set_search import Search
from canest.diagnosis.sentences import by_urgency

#: alternatives of one selected effect that are fitted in its place; further ones are only named
MAX_REFITTED = 6


@dataclass(frozen=True)
class Entry:
    """One candidate as it is reported.

    deviation, std: of the fitted parameter, from its neutral value; of the joint fit where it is selected,
    in the place of the selected one where it is equivalent, else alone. explained: share of the held-out
    residual variance that this effect removes there; score: that the whole model with it removes.
    """

    candidate: Candidate
    deviation: float
    std: float
    explained: float
    score: float
    selected: bool
    equivalent: tuple[str, ...]

    def parameters(self) -> dict[str, dict[str, Any]]:
        """Return every parameter by its config name: value, std (None where it is not fitted), unit."""
        c, found = self.candidate, {}
        effect = c.make(self.deviation)
        for field in fields(effect):
            if field.name in effect.settings:
                continue
            value = getattr(effect, field.name)
            known = effect.parameters.get(field.name)
            fitted = field.name == c.parameter
            found[field.name.removeprefix("on_")] = {
                "value": _json_value(value) if fitted else value,
                "std": _json_value(self.std) if fitted else None,
                "unit": known.unit if known else "",
            }
        return found

    def settings(self) -> dict[str, Any]:
        """Return what else the effect's config entry has: by what mass, above which level, ..."""
        effect = self.candidate.make(self.deviation)
        return {name: _json_value(getattr(effect, name)) for name in effect.settings}

    def to_json(self) -> dict[str, Any]:
        """Return the contract's keys, and the settings."""
        return {
            "effect": self.candidate.effect,
            "parameters": self.parameters(),
            "settings": self.settings(),
            "score": round(self.score, 5),
            "explained": round(self.explained, 5),
            "equivalent": list(self.equivalent),
            "selected": self.selected,
        }


def entries(diagnosis: Diagnosis) -> list[Entry]:
    """Return every effect tried, best first: the selected ones, then the others by what they would remove."""
    search = diagnosis.search
    # where nothing is selected, the best model with an effect in it is that effect alone
    whole = _share(search) if search.chosen else 1.0
    found = [
        Entry(c.candidate, c.deviation, c.std, unit_share(c.explained), whole, True, _names(c.equivalent, c))
        for c in search.chosen
    ]
    listed = {c.candidate.effect for c in search.chosen}
    for chosen in search.chosen:
        others = [c for c in _one_each(chosen.equivalent) if c.effect not in listed and not c.confounded]
        for candidate in others[:MAX_REFITTED]:
            listed.add(candidate.effect)
            found.append(_in_place(search, chosen, candidate, whole))
    for tried in diagnosis.tried:
        c = tried.candidate
        # with a free mass a scale effect would only make everything smaller: its value means nothing
        if c.effect not in listed and not c.confounded:
            listed.add(c.effect)
            share = unit_share(tried.explained)
            alike = _names(search.alternatives.alike(c), c)
            found.append(Entry(c, tried.deviation, tried.std, share, min(share, whole), False, alike))
    order = sorted(range(len(found)), key=lambda i: (not found[i].selected, -found[i].score, i))
    return [found[i] for i in order]


def _in_place(search: Search, chosen: Chosen, candidate: Candidate, whole: float) -> Entry:
    """Fit an equivalent effect in the place of the selected one."""
    other = _with(search, [*(c for c in search.chosen if c is not chosen), Chosen(candidate, 0.0)])
    fitted = other.chosen[-1]
    share = _share(other)
    names = by_urgency((chosen.candidate.effect, *_names(chosen.equivalent, fitted)))
    explained = unit_share(chosen.explained - (whole - share))
    return Entry(
        candidate,
        fitted.deviation,
        fitted.std,
        explained,
        min(share, whole),
        False,
        tuple(names),
    )


def _with(search: Search, chosen: Sequence[Chosen]) -> Search:
    """Return the search with copies of other choices, refitted."""
    other = copy(search)
    other.chosen = [Chosen(c.candidate, c.deviation) for c in chosen]
    other.refit()
    other.widen()
    return other


def _share(search: Search) -> float:
    """Return the share of held-out variance (in units of what the reference lets see) that is removed."""
    before, after = search.held_out_variance(after=False), search.held_out_variance(after=True)
    return unit_share(1.0 - after / before) if before > 0 else 0.0


def _one_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    return list({c.effect: c for c in reversed(candidates)}.values())[::-1]


def _names(candidates: Sequence[Candidate], own: Candidate | Chosen) -> tuple[str, ...]:
    mine = own.candidate.effect if isinstance(own, Chosen) else own.effect
    return tuple(by_urgency(c.effect for c in candidates if c.effect != mine))


def unit_share(share: float) -> float:
    """Return a share between 0 and 1, 0 for one that is no number."""
    return float(np.clip(share, 0.0, 1.0)) if np.isfinite(share) else 0.0


def _json_value(value: Any) -> Any:
    """Return a JSON value: no infinity, no numpy scalar."""
    if isinstance(value, float | np.floating):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
