"""What a diagnosis found, as the document that becomes `diagnosis.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from canest import __version__
from canest.config.schema import Config
from canest.diagnosis.data.reference import Reference
from canest.diagnosis.entries import Entry, unit_share
from canest.diagnosis.run import Diagnosis
from canest.diagnosis.search.dependence import causes, depends
from canest.vehicle.effects import all_effects, effect_class, skipped_effects

#: why nothing was tried
TOO_LITTLE = "too little driving with open gates"
#: signals of the bus that are listed
MAX_SIGNALS = 20


def document(
    diagnosis: Diagnosis, found: Sequence[Entry], logs: Sequence[str], config_name: str
) -> dict[str, Any]:
    """Return the whole of diagnosis.json. config_name: what the diagnosis was called with."""
    problem = diagnosis.problem
    return {
        "canest": __version__,
        "config": config_name,
        "finding": diagnosis.finding,
        "details": list(diagnosis.details),
        "verdict": diagnosis.verdict,
        "selected": [c.candidate.effect for c in diagnosis.search.chosen],
        "baseline": diagnosis.before.to_json(),
        "after": diagnosis.after.to_json(),
        "candidates": [e.to_json() for e in found],
        "models": models_of(diagnosis),
        "not_excluded": diagnosis.not_excluded,
        "steps": [
            {"with": s.added.candidate.effect, "residual_rms_N": round(s.residual_rms_N, 2)}
            for s in diagnosis.steps
        ],
        "not_tried": not_tried(diagnosis, found),
        "dependence": dependence(diagnosis),
        "reference": reference_of(diagnosis.references),
        "remainder": {
            "residual_rms_N": round(diagnosis.after.residual_rms_N, 2),
            "share_of_weight": round(diagnosis.after.residual_rms_N / problem.weight_N, 6),
        },
        "unused_signals": [
            {"signal": r.name, "explained": round(unit_share(r.explained), 4), "switches": bool(r.switches)}
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


def models_of(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the sets of effects that this data does not separate, likeliest first (torque delay apart).

    odds: of each set against the likeliest one, by the data alone. selected: whether it is the one taken.
    """
    rivals = diagnosis.search.rivals
    best = min((r.criterion for r in rivals), default=0.0)
    return [
        {
            "effects": {c.candidate.effect: float(f"{c.value:.4g}") for c in rival.chosen},
            "odds": round(float(np.exp(-0.5 * (rival.criterion - best))), 4),
            "selected": rival.has_effects_of(diagnosis.search.chosen),
        }
        for rival in rivals
    ]


def dependence(diagnosis: Diagnosis) -> dict[str, dict[str, float]]:
    """Return what share of the residual a curve over each quantity would explain, before and after."""
    problem = diagnosis.problem
    before, after = (problem.whiten(r) for r in (diagnosis.residual_before_N, diagnosis.residual_after_N))
    return {
        name: {"before": round(depends(c.values, before), 4), "after": round(depends(c.values, after), 4)}
        for name, c in causes(problem).items()
    }


def empty_document(
    finding: str,
    logs: Sequence[str],
    config: Config,
    config_name: str,
    notes: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """Return the document of logs in which the gates were never open for long enough to measure anything."""
    unknown = dict.fromkeys(
        ("residual_rms_N", "mass_kg", "mass_error_pct", "mass_rms_pct", "grade_rms_deg"), None
    )
    return {
        "canest": __version__,
        "config": config_name,
        "finding": finding,
        "details": [],
        "verdict": "nothing-to-explain",
        "selected": [],
        "baseline": unknown,
        "after": dict(unknown),
        "candidates": [],
        "models": [],
        "not_excluded": [],
        "steps": [],
        "not_tried": dict.fromkeys(all_effects(), TOO_LITTLE) | _unusable(),
        "unused_signals": [],
        "data": {
            "logs": list(logs),
            "left_out": list(logs),
            "notes": {log: list(texts) for log, texts in notes.items()},
            "drives": 0,
            "open_s": 0,
            "blocks": 0,
            "vehicle": config.vehicle.name,
        },
    }


def not_tried(diagnosis: Diagnosis, found: Sequence[Entry]) -> dict[str, str]:
    """Return the known effects that could not be tried on this data, and why; unusable ones too."""
    tried = {e.candidate.effect for e in found}
    reasons = {name: _why_untried(diagnosis, name) for name in all_effects() if name not in tried}
    return reasons | _unusable()


def _unusable() -> dict[str, str]:
    return {name: f"cannot be used: {why}" for name, why in skipped_effects().items()}


def _why_untried(diagnosis: Diagnosis, name: str) -> str:
    cls, candidates = effect_class(name), diagnosis.search.candidates
    if name in diagnosis.search.failed:
        return diagnosis.search.failed[name]
    if not candidates:
        return TOO_LITTLE
    if cls.scales_traction and not diagnosis.problem.mass_known:
        return "one thing with the unknown mass: give --mass or --truth"
    if any(c.effect == name for c in candidates):
        return "nothing in this data depends on it"
    if cls.untried_reason:
        return cls.untried_reason
    signal = cls().signal
    return f"the signal map names no {signal}" if signal else "cannot be found in this data"


def reference_of(references: Sequence[Reference]) -> dict[str, Any]:
    """Return what the residual was measured against (of several drives: the commonest kind)."""
    kinds = [r.kind for r in references]
    commonest = max(references, key=lambda r: kinds.count(r.kind))
    limits = reference_limits(references)
    return {
        "kind": commonest.kind,
        "text": commonest.text,
        "mass_known": all(r.mass_kg is not None for r in references),
        "sin_beta_std": float(np.mean([r.sin_beta_std for r in references])),
        "correlation_m": round(float(np.mean([r.correlation_m for r in references])), 1),
        "limits": limits,
        "tells": limits,  # deprecated
    }


def reference_limits(references: Sequence[Reference]) -> str:
    """Return as a sentence which effects this kind of reference can and cannot separate."""
    mass = all(r.mass_kg is not None for r in references)
    if all(r.sin_beta_std == 0.0 for r in references):
        text = "The grade is known, so every force that is not in the model shows, steady ones too"
    elif any(r.kind == "none" for r in references):
        text = (
            "Nothing measures the grade: a steady force and a slope are one thing here. Only what "
            "changes faster with torque, gear or speed than a road does can be traced"
        )
    else:
        text = (
            "The grade is measured with an error that lasts for some time. Steady forces show less sharply "
            "than what changes with torque, gear or speed"
        )
    return text + (
        ". The mass is known."
        if mass
        else ". The mass is not known, so torque gain, overall driveline loss and wheel radius cannot be "
        "separated from it and were not tried."
    )
