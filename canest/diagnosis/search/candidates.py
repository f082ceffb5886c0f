"""Every known effect as something to try: one parameter is fitted, its shape (gear, signal ...) is fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canest.diagnosis.data.problem import Problem
from canest.diagnosis.search.driven_data import driven_data
from canest.vehicle.effects import Effect, Parameter, all_effects, effect_class, effect_from_config


@dataclass(frozen=True)
class Candidate:
    """One effect with its shape fixed; `make(deviation)` builds it at neutral + deviation."""

    label: str
    effect: str
    parameter: str
    shape: tuple[tuple[str, object], ...] = ()
    #: with an unknown mass: never selected, only named where the data cannot separate it from what is
    confounded: bool = False
    #: no vehicle of this config can have less (no negative inertia, drag or rolling resistance in all)
    low: float = -np.inf
    #: its standard deviation among vehicles that have it as a fault, or what a measurement leaves of that
    scale: float = np.inf

    @property
    def kind(self) -> type[Effect]:
        """Return the effect's class."""
        return effect_class(self.effect)

    @property
    def info(self) -> Parameter:
        """Unit, neutral value, bounds and step of the fitted parameter."""
        info = self.kind.parameters[self.parameter]
        return replace(info, low=max(info.low, self.low))

    def possible(self, deviation: float) -> bool:
        """Return whether a vehicle can be like that: strictly between the parameter's bounds."""
        info = self.info
        return bool(info.low < info.neutral + deviation < info.high)

    def reached_end(self, deviation: float) -> float | None:
        """Return the end of the range (the neutral one is none) within a step of a value; None where far."""
        info = self.info
        value = info.neutral + deviation
        for end in (info.low, info.high):
            if abs(value - end) < min(info.step, 0.5 * abs(end - info.neutral)):
                return end
        return None

    def make(self, deviation: float) -> Effect:
        """Build the effect; the deviation is clipped to the parameter's bounds."""
        info = self.info
        value = float(np.clip(info.neutral + deviation, info.low, info.high))
        return effect_from_config({"effect": self.effect, self.parameter: value} | dict(self.shape))

    @property
    def rarity(self) -> int:
        """Place among effects that the data cannot separate: the lowest is the commonest."""
        return self.kind.rarity

    @property
    def family(self) -> tuple[str, bool]:
        """Return what its other forms share: the effect, and whether it is of one gear, signal or stop.

        A loss in all gears is not one of many: it has odds of its own beside those in one of the gears.
        """
        return self.effect, dict(self.shape).get(self.kind.several_by) is not None

    @property
    def is_delay(self) -> bool:
        """Return whether it delays the torque; every engine controller has some delay."""
        return self.kind.stage == "sampling"

    def repeats(self, other: Candidate) -> bool:
        """Return whether it is the same effect again, and not of another gear, signal or stop."""
        if self.effect != other.effect:
            return False
        mine, theirs = (dict(c.shape).get(self.kind.several_by) for c in (self, other))
        return mine is None or theirs is None or mine == theirs


def candidates_for(problem: Problem, switches: Sequence[str] = ()) -> list[Candidate]:
    """Return everything worth trying on these drives.

    switches: roles that may switch a load. Effects whose signals the signal map lacks are left out.
    """
    drives = driven_data(problem, switches)
    vehicle = problem.parts[0].drive.config.vehicle
    found = []
    for name, cls in all_effects().items():
        parameter = cls.fitted_parameter()
        for trial in cls.trials(drives):
            # a common factor on all traction is nearly one thing with a free mass: never to be claimed then
            confounded = cls.scales_traction and not trial.shape and not problem.mass_known
            low = cls.parameters[parameter].lowest(vehicle)
            scale = min(cls.parameters[parameter].fault_std(vehicle), trial.measured_std)
            found.append(Candidate(trial.label, name, parameter, trial.shape, confounded, low, scale))
    return found
