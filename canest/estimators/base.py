"""The one interface of all estimators."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from canest.core.samples import EstimateBlock, ModelBlock, VehicleFacts
from canest.estimators.description import Description
from canest.estimators.options import parse
from canest.estimators.status import VALID_RATIO


class Estimator(ABC):
    """A causal estimator of mass and grade.

    `update` takes the next stretch of samples and returns one estimate per sample. It keeps its state
    between calls and gives the same bits however the samples are cut. The force of a gated
    sample (``block.gate != 0``) never teaches a mass; the sample still gets an estimate. Nothing it returns
    is ever infinite or outside the vehicle's bounds; NaN means "no number", never "went wrong".
    """

    #: the estimators that this class serves, one description per name
    descriptions: ClassVar[tuple[Description, ...]] = ()
    #: what the method's author has set: a named tuple of `Annotated` numbers (see `constant_rows`)
    constants: tuple[Any, ...] = ()
    #: True when the method winds up without excitation and so wants the low_excitation gate
    wants_excitation_gate: ClassVar[bool] = False
    #: True when `valid` follows the config's `valid_std_pct`
    valid_is_configured: ClassVar[bool] = False
    #: True when the method gives no mass of its own (a grade observer)
    estimates_mass: ClassVar[bool] = True

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        self.name, self.facts = name, facts
        self.options: Any = parse(self.description.options, options)

    @property
    def description(self) -> Description:
        """Return the description under the name that this estimator was made with."""
        return next(d for d in self.descriptions if d.name == self.name)

    @property
    def valid_std(self) -> float:
        """Return the standard deviation, as a share of the mass, below which a mass is valid."""
        return self.facts.valid_std if self.valid_is_configured else VALID_RATIO

    @abstractmethod
    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples, return their estimates (same length)."""

    def missing(self) -> str:
        """Return why this estimator cannot work with this vehicle's signals ('' when it can)."""
        return ""

    def contradiction(self) -> str:
        """Return what in the samples contradicts the vehicle's facts, one sentence ('' for nothing)."""
        return ""

    def snapshot(self) -> dict[str, Any]:
        """Return what is worth keeping over a restart: at least mass_kg, mass_std_kg (JSON types)."""
        return {}

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:  # noqa: B027
        """Start from a saved mass and its standard deviation.

        unseen_s: time since then in which the load may have changed and nobody saw it (0: none).
        """
