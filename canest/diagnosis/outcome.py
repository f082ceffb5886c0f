"""What a diagnosis found, as `diagnosis.json` says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from canest.diagnosis.data.reference import Reference
from canest.diagnosis.run import Diagnosis
from canest.diagnosis.search.candidates import SCALE_EFFECTS, Candidate
from canest.diagnosis.search.choice import Chosen
from canest.diagnosis.search.dependence import causes, depends
from canest.diagnosis.search.forward_selection import Search
from canest.vehicle.effects import EFFECTS

#: alternatives of one selected effect that are fitted in its place; further ones are only named
MAX_REFITTED = 6
#: signals of the bus that are listed
MAX_SIGNALS = 20


@dataclass(frozen=True)
class Entry:
    """One candidate as it is told.

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
        c, told = self.candidate, {}
        effect = c.make(self.deviation)
        for field in fields(effect):
            if field.name in effect.settings:
                continue
            value = getattr(effect, field.name)
            known = EFFECTS[c.effect].parameters.get(field.name)
            fitted = field.name == c.parameter
            told[field.name.removeprefix("on_")] = {
                "value": _plain(value) if fitted else value,
                "std": _plain(self.std) if fitted else None,
                "unit": known.unit if known else "",
            }
        return told

    def settings(self) -> dict[str, Any]:
        """Return what the effect's config entry says besides: by what mass, above which level, ..."""
        effect = self.candidate.make(self.deviation)
        return {name: _plain(getattr(effect, name)) for name in effect.settings}

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
        Entry(c.candidate, c.deviation, c.std, _unit(c.explained), whole, True, _names(c.equivalent, c))
        for c in search.chosen
    ]
    told = {c.candidate.effect for c in search.chosen}
    for chosen in search.chosen:
        others = [c for c in _one_each(chosen.equivalent) if c.effect not in told and not c.shadow]
        for candidate in others[:MAX_REFITTED]:
            told.add(candidate.effect)
            found.append(_in_place(search, chosen, candidate, whole))
    for tried in diagnosis.tried:
        c = tried.candidate
        # with a free mass a scale effect would only make everything smaller: its value means nothing
        if c.effect not in told and not c.shadow:
            told.add(c.effect)
            share = _unit(tried.explained)
            alike = _names(search.alternatives.alike(c), c)
            found.append(Entry(c, tried.deviation, tried.std, share, min(share, whole), False, alike))
    order = sorted(range(len(found)), key=lambda i: (not found[i].selected, -found[i].score, i))
    return [found[i] for i in order]


def document(diagnosis: Diagnosis, found: Sequence[Entry], logs: Sequence[str]) -> dict[str, Any]:
    """Return the whole of diagnosis.json."""
    problem = diagnosis.problem
    return {
        "finding": diagnosis.finding,
        "verdict": diagnosis.verdict,
        "selected": [c.candidate.effect for c in diagnosis.search.chosen],
        "baseline": diagnosis.before.to_json(),
        "after": diagnosis.after.to_json(),
        "candidates": [e.to_json() for e in found],
        "not_tried": not_tried(diagnosis, found),
        "dependence": dependence(diagnosis),
        "reference": reference_of(diagnosis.references),
        "remainder": {
            "residual_rms_N": round(diagnosis.after.residual_rms_N, 2),
            "share_of_weight": round(diagnosis.after.residual_rms_N / problem.weight_N, 6),
        },
        "unused_signals": [
            {"signal": r.name, "explained": round(_unit(r.explained), 4), "switches": bool(r.switches)}
            for r in diagnosis.ranked[:MAX_SIGNALS]
        ],
        "data": {
            "logs": list(logs),
            "left_out": problem.failed + problem.left_out,
            "notes": problem.notes,
            "drives": len(problem.parts),
            "open_s": problem.rows,
            "blocks": problem.chunks,
            "vehicle": diagnosis.config.vehicle.name,
        },
    }


def dependence(diagnosis: Diagnosis) -> dict[str, dict[str, float]]:
    """Return what share of the residual a curve over each quantity would explain, before and after."""
    problem = diagnosis.problem
    before, after = (problem.whiten(r) for r in (diagnosis.residual_before_N, diagnosis.residual_after_N))
    return {
        name: {"before": round(depends(c.values, before), 4), "after": round(depends(c.values, after), 4)}
        for name, c in causes(problem).items()
    }


def empty_document(
    finding: str, logs: Sequence[str], vehicle: str, notes: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Return the document of logs in which the gates were never open for long enough to measure anything."""
    unknown = dict.fromkeys(
        ("residual_rms_N", "mass_kg", "mass_error_pct", "mass_rms_pct", "grade_rms_deg"), None
    )
    return {
        "finding": finding,
        "verdict": "nothing-to-explain",
        "selected": [],
        "baseline": unknown,
        "after": dict(unknown),
        "candidates": [],
        "not_tried": dict.fromkeys(EFFECTS, "too little driving with open gates"),
        "unused_signals": [],
        "data": {
            "logs": list(logs),
            "left_out": list(logs),
            "notes": {log: list(said) for log, said in notes.items()},
            "drives": 0,
            "open_s": 0,
            "blocks": 0,
            "vehicle": vehicle,
        },
    }


def not_tried(diagnosis: Diagnosis, found: Sequence[Entry]) -> dict[str, str]:
    """Return the effects of the vocabulary that this data could not say anything about, and why."""
    tried = {e.candidate.effect for e in found}
    offered = {c.effect for c in diagnosis.search.candidates}
    reasons = {
        "cornering_drag": "the signal map names no yaw_rate",
        "retarder_unreported": "the signal map names no accelerator",
        "rolling_resistance_temperature": "the ambient temperature is not known, or the same in all drives",
        "switched_load": "no signal of the bus that goes on and off explains anything",
        "payload_change": "no stop of 30 s between driving, or drives of the same time",
    }
    told = {}
    for name in EFFECTS:
        if name in tried:
            continue
        if not diagnosis.search.candidates:
            told[name] = "too little driving with open gates"
        elif name in SCALE_EFFECTS and not diagnosis.problem.mass_known:
            told[name] = "one thing with the unknown mass: give --mass or --truth"
        elif name in offered:
            told[name] = "nothing in this data depends on it"
        else:
            told[name] = reasons.get(name, "cannot be told from this data")
    return told


def reference_of(references: Sequence[Reference]) -> dict[str, Any]:
    """Return what the residual was measured against (of several drives: the commonest kind)."""
    kinds = [r.kind for r in references]
    commonest = max(references, key=lambda r: kinds.count(r.kind))
    return {
        "kind": commonest.kind,
        "text": commonest.text,
        "mass_known": all(r.mass_kg is not None for r in references),
        "sin_beta_std": float(np.mean([r.sin_beta_std for r in references])),
        "correlation_m": round(float(np.mean([r.correlation_m for r in references])), 1),
        "tells": tells(references),
    }


def tells(references: Sequence[Reference]) -> str:
    """Return in words what this kind of reference can and cannot tell apart."""
    mass = all(r.mass_kg is not None for r in references)
    if all(r.sin_beta_std == 0.0 for r in references):
        text = "The grade is known, so every force that is not in the model shows, steady ones too"
    elif any(r.kind == "none" for r in references):
        text = (
            "Nothing measures the grade: a steady force and a slope are one thing here, and only what "
            "changes faster with torque, gear or speed than a road does can be traced"
        )
    else:
        text = (
            "The grade is measured with an error that lasts for some time: steady forces show less sharply "
            "than what changes with torque, gear or speed"
        )
    return text + (
        "; the mass is known."
        if mass
        else "; the mass is not known, so torque gain, overall driveline loss and wheel radius cannot be "
        "told from it and were not tried."
    )


def _in_place(search: Search, chosen: Chosen, candidate: Candidate, whole: float) -> Entry:
    """Fit an equivalent effect in the place of the selected one."""
    other = _with(search, [*(c for c in search.chosen if c is not chosen), Chosen(candidate, 0.0)])
    fitted = other.chosen[-1]
    share = _share(other)
    names = (chosen.candidate.effect, *(n for n in _names(chosen.equivalent, fitted)))
    explained = _unit(chosen.explained - (whole - share))
    return Entry(
        candidate,
        fitted.deviation,
        fitted.std,
        explained,
        min(share, whole),
        False,
        tuple(dict.fromkeys(names)),
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
    return _unit(1.0 - after / before) if before > 0 else 0.0


def _one_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    return list({c.effect: c for c in reversed(candidates)}.values())[::-1]


def _names(candidates: Sequence[Candidate], own: Candidate | Chosen) -> tuple[str, ...]:
    mine = own.candidate.effect if isinstance(own, Chosen) else own.effect
    return tuple(dict.fromkeys(c.effect for c in candidates if c.effect != mine))


def _unit(share: float) -> float:
    return float(np.clip(share, 0.0, 1.0)) if np.isfinite(share) else 0.0


def _plain(value: Any) -> Any:
    """Return a JSON value: no infinity, no numpy scalar."""
    if isinstance(value, float | np.floating):
        return float(f"{value:.6g}") if np.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value
