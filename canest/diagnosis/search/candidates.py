"""Every effect of the vocabulary as something to try: one parameter each, its shape (gear, signal) fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from canest.core.samples import LOADING_S, RATE_HZ
from canest.diagnosis.data.problem import Problem
from canest.vehicle.effects import EFFECTS, Effect, Parameter, effect_from_config

#: seconds of open driving that a gear needs before its own loss can be told
MIN_GEAR_S = 6
#: drives must differ so much in temperature before its effect can be told
MIN_TEMPERATURE_SPAN_K = 5.0
#: effects that scale all traction, as an unknown mass does
SCALE_EFFECTS = ("torque_gain", "driveline_loss", "wheel_radius")
#: warm-up times tried, s; the best is refined afterwards
WARMUP_TAUS_S = (120.0, 300.0, 600.0, 1200.0)
#: of effects that a drive cannot tell apart, the commonest is named first
PLAUSIBILITY = (
    "torque_delay",
    "headwind",
    "torque_gain",
    "rolling_resistance",
    "switched_load",
    "driveline_loss",
    "wheel_radius",
    "torque_offset",
    "drag_area",
    "rotating_inertia",
    "retarder_unreported",
    "cornering_drag",
    "rolling_warmup",
    "rolling_resistance_temperature",
    "brake_drag",
    "wheel_slip",
    "rolling_resistance_speed",
    "payload_change",
)


@dataclass(frozen=True)
class Candidate:
    """One effect with its shape fixed; `make(deviation)` builds it at neutral + deviation."""

    label: str
    effect: str
    parameter: str
    shape: tuple[tuple[str, object], ...] = ()
    #: never selected, only named where the data cannot tell it from what is
    shadow: bool = False
    #: no vehicle of this config can have less (no negative inertia, drag or rolling resistance in all)
    low: float = -np.inf

    @property
    def info(self) -> Parameter:
        """Unit, neutral value, bounds and step of the fitted parameter."""
        info = EFFECTS[self.effect].parameters[self.parameter]
        return replace(info, low=max(info.low, self.low))

    def possible(self, deviation: float) -> bool:
        """Return whether a vehicle can be like that: strictly between the parameter's bounds."""
        info = self.info
        return bool(info.low < info.neutral + deviation < info.high)

    def make(self, deviation: float) -> Effect:
        """Build the effect; the deviation is clipped to the parameter's bounds."""
        info = self.info
        value = float(np.clip(info.neutral + deviation, info.low, info.high))
        return effect_from_config({"effect": self.effect, self.parameter: value} | dict(self.shape))

    @property
    def rank(self) -> int:
        """Place in the order of plausibility."""
        return PLAUSIBILITY.index(self.effect) if self.effect in PLAUSIBILITY else len(PLAUSIBILITY)


def candidates_for(
    problem: Problem, switches: Sequence[str] = (), *, mass_kg: float | None = None
) -> list[Candidate]:
    """Return everything worth trying on these drives.

    switches: roles that may switch a load. Effects whose signals the signal map lacks are left out.
    """
    roles = set(problem.parts[0].drive.config.signals)
    plain = {
        "headwind": "wind_mps",
        "drag_area": "cda_delta_m2",
        "rolling_resistance": "crr_delta",
        "rolling_resistance_speed": "crr_per_mps",
        "torque_gain": "gain",
        "torque_offset": "torque_Nm",
        "torque_delay": "delay_s",
        "driveline_loss": "loss",
        "wheel_radius": "factor",
        "rotating_inertia": "inertia_kgm2",
        "brake_drag": "force_N",
    }
    # a common factor on all traction is nearly one thing with a free mass: never to be claimed then
    shadows = () if problem.mass_known else SCALE_EFFECTS
    v = problem.parts[0].drive.config.vehicle
    least = {
        "rotating_inertia": -v.engine_inertia_kgm2,
        "drag_area": -v.drag_area_m2,
        "rolling_resistance": -v.rolling_resistance,
    }
    found = [
        Candidate(name, name, parameter, shadow=name in shadows, low=least.get(name, -np.inf))
        for name, parameter in plain.items()
    ]
    found += [
        Candidate(f"rolling_warmup tau {tau:g} s", "rolling_warmup", "crr_cold", (("tau_s", tau),))
        for tau in WARMUP_TAUS_S
    ]
    shape = (("mass_kg", mass_kg or float(problem.parts[0].mass_w.mean())),)
    found.append(Candidate("wheel_slip", "wheel_slip", "slip_per_mps2", shape))
    if _temperature_span_K(problem) > MIN_TEMPERATURE_SPAN_K:
        name = "rolling_resistance_temperature"
        found.append(Candidate(name, name, "crr_per_K"))
    if "yaw_rate" in roles:
        found.append(Candidate("cornering_drag", "cornering_drag", "coefficient_s2pm"))
    if "accelerator" in roles:
        found.append(
            Candidate(
                "retarder_unreported pedal up", "retarder_unreported", "torque_Nm", (("cause", "pedal_up"),)
            )
        )
    found += [
        Candidate(f"driveline_loss gear {gear}", "driveline_loss", "loss", (("gear", gear),))
        for gear in _gears(problem)
    ]
    for role in switches:
        for exponent in (0.0, 3.0):
            form = "constant power" if exponent == 0 else "cubic in engine speed"
            found.append(
                Candidate(
                    f"switched_load {role} {form}",
                    "switched_load",
                    "power_kW",
                    (("signal", role), ("exponent", exponent), ("threshold", _threshold(problem, role))),
                )
            )
    found += [
        Candidate(f"payload_change at {t_s:.0f} s", "payload_change", "mass_delta_kg", (("t_s", t_s),))
        for t_s in _loading_stops(problem)
    ]
    return found


def _loading_stops(problem: Problem) -> list[float]:
    """Return when the vehicle stood for long enough to be loaded, the middle of each such stop, s.

    A time says which drive is meant only where no other one was at that time.
    """
    spans = sorted(tuple(p.run.samples.t_us[[0, -1]].tolist()) for p in problem.parts)
    if any(begin <= end for (_, end), (begin, _) in pairwise(spans)):
        return []
    found = []
    for part in problem.parts:
        stopped = np.concatenate(([False], part.run.samples.stopped, [False]))
        edges = np.flatnonzero(np.diff(stopped.astype(np.int8)))
        t_s, passed_s, driven_s = part.run.samples.t_us * 1e-6, part.run.t_s, part.windows.t_s
        for begin, end in edges.reshape(-1, 2).tolist():
            between = driven_s.size and driven_s[0] < passed_s[begin] and passed_s[end - 1] < driven_s[-1]
            if between and t_s[end - 1] - t_s[begin] >= LOADING_S:
                found.append(round(float(0.5 * (t_s[begin] + t_s[end - 1])), 1))
    return found


def _temperature_span_K(problem: Problem) -> float:
    """Return how far the ambient temperature of the drives differs, 0 where it is not known."""
    known = []
    for part in problem.parts:
        column = part.run.signals.get("ambient_temperature", np.empty(0))
        if np.isfinite(column).any():
            known.append(float(np.nanmean(column)))
    return max(known) - min(known) if known else 0.0


def _gears(problem: Problem) -> list[int]:
    """Return the gears driven in that an effect may name: where the config has a table, those in it."""
    table = problem.parts[0].drive.config.vehicle.gear_ratios
    gears = np.concatenate([p.run.gear[p.windows.index >= 0] for p in problem.parts])
    numbers, counts = np.unique(gears[gears > 0], return_counts=True)
    if len(numbers) < 2:
        return []
    long = [int(g) for g, c in zip(numbers, counts, strict=True) if c >= MIN_GEAR_S * RATE_HZ]
    return [gear for gear in long if gear in table or not table]


def _threshold(problem: Problem, role: str) -> float:
    """Return the level halfway between a switching signal's off and on."""
    values = np.concatenate([p.run.signals[role] for p in problem.parts])
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [2, 98]) if len(values) else (0.0, 1.0)
    return float(0.5 * (low + high))


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
