"""What the drives of a diagnosis hold that decides which effects are worth trying."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from canest.core.samples import LOADING_S, RATE_HZ
from canest.diagnosis.data.problem import Problem
from canest.doctor.engine_and_road import MIN_MPS
from canest.doctor.proportion import Proportion
from canest.vehicle.effects import DrivenData

#: seconds of open driving that a gear needs before its own loss can be seen
MIN_GEAR_S = 6


def driven_data(problem: Problem, switches: Sequence[str]) -> DrivenData:
    """Return what these drives hold. switches: roles that go on and off."""
    first = problem.parts[0]
    return DrivenData(
        roles=frozenset(first.drive.config.signals),
        mass_kg=float(round(first.mass_w.mean())),
        gears=_gears(problem),
        temperature_span_K=_temperature_span_K(problem),
        loading_stops_s=_loading_stops(problem),
        switches={role: _level_between(problem, role) for role in switches},
        radius_factor=_radius_factor(problem),
    )


def _radius_factor(problem: Problem) -> float | None:
    """Return the satellites' speed over that of the driven wheels at the declared radius; None for unknown.

    A config that has a wheel radius as an effect says itself that the declared one is not the true one.
    """
    found = Proportion()
    for part in problem.parts:
        config, signals = part.drive.config, part.run.signals
        if "gps_speed" not in signals or any(e["effect"] == "wheel_radius" for e in config.effects):
            return None
        speeds = {"output_shaft_speed": config.vehicle.mps_per_shaft_rpm, "vehicle_speed": 1.0}
        used = next((role for role in speeds if np.isfinite(signals.get(role, np.nan)).any()), None)
        if used is not None:
            wheels_mps = signals[used] * speeds[used]
            found.add(signals["gps_speed"], wheels_mps, wheels_mps > MIN_MPS)
    return found.times


def _loading_stops(problem: Problem) -> list[float]:
    """Return when the vehicle stood for long enough to be loaded, the middle of each such stop, s.

    A time identifies a drive only where no other one was at that time.
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


def _level_between(problem: Problem, role: str) -> float:
    """Return the level halfway between a switching signal's off and on, to a tenth of that distance."""
    values = np.concatenate([p.run.signals[role] for p in problem.parts])
    values = values[np.isfinite(values)]
    low, high = np.percentile(values, [2, 98]) if len(values) else (0.0, 1.0)
    decimals = 1 - int(np.floor(np.log10(max(high - low, 1e-12))))
    return round(float(0.5 * (low + high)), decimals)
