"""The one interface of all estimators, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar

from canest.core.errors import ConfigError
from canest.core.samples import EstimateBlock, ModelBlock, VehicleFacts

#: estimator name -> module that defines it (imported only when used)
REGISTRY: dict[str, str] = {
    "batch-ls": "canest.estimators.papers.vahidi2005.batch",
    "rls": "canest.estimators.papers.vahidi2005.rls",
    "rls-vector": "canest.estimators.papers.vahidi2005.rls",
    "rlsmf": "canest.estimators.papers.vahidi2005.rlsmf",
    "rlsmf-n": "canest.estimators.papers.vahidi2005.rlsmf",
    "resistance4": "canest.estimators.papers.rhode2013.resistance4",
    "tls": "canest.estimators.papers.rhode2013.tls",
    "gtls": "canest.estimators.papers.rhode2013.tls",
    "rtls": "canest.estimators.papers.rhode2013.rtls",
    "rgtls": "canest.estimators.papers.rhode2013.rtls",
    "ekf": "canest.estimators.papers.kidambi2014.ekf",
    "ekf-select": "canest.estimators.papers.kidambi2014.ekf_select",
    "dgo": "canest.estimators.papers.kidambi2014.dgo",
    "pmg": "canest.estimators.papers.kidambi2014.pmg",
    "canest": "canest.estimators.canest_0_1.estimator",
}


class Estimator(ABC):
    """A causal estimator of mass and grade.

    `update` takes the next stretch of samples and returns one estimate per sample. It keeps its state
    between calls and gives the same bits however the samples are cut. A gated sample
    (``block.gate != 0``) never changes what is learned; it still gets an estimate. Nothing it returns
    is ever infinite or outside the vehicle's bounds; NaN means "no number", never "went wrong".
    """

    #: names this class serves (keys of `REGISTRY`)
    names: ClassVar[tuple[str, ...]] = ()
    #: True when the method winds up without excitation and so wants the low_excitation gate
    wants_excitation_gate: ClassVar[bool] = False
    #: True when the method gives no mass of its own (a grade observer)
    estimates_mass: ClassVar[bool] = True

    def __init__(self, name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> None:
        self.name, self.facts = name, facts

    @abstractmethod
    def update(self, block: ModelBlock) -> EstimateBlock:
        """Take the next samples, return their estimates (same length)."""

    def missing(self) -> str:
        """Return why this estimator cannot work with this vehicle's signals ('' when it can)."""
        return ""

    def doubts(self) -> str:
        """Return what the samples have to say against the vehicle's facts, one sentence ('' for nothing)."""
        return ""

    def snapshot(self) -> dict[str, Any]:
        """Return what is worth keeping over a restart: at least mass_kg, mass_std_kg (JSON types)."""
        return {}

    def restore(self, mass_kg: float, mass_std_kg: float) -> None:  # noqa: B027
        """Start from a remembered mass and its (already widened) standard deviation."""


def require_known(name: str, where: str = "estimator.name") -> None:
    """Refuse a name that no estimator has. Errors: ConfigError."""
    if name not in REGISTRY:
        expected = "one of " + ", ".join(REGISTRY)
        raise ConfigError("unknown estimator", where=where, found=name, expected=expected)


def create(name: str, facts: VehicleFacts, options: Mapping[str, Any] | None = None) -> Estimator:
    """Build the estimator ``name``.

    Errors: ConfigError for an unknown name or option.
    """
    require_known(name)
    module = import_module(REGISTRY[name])
    for candidate in vars(module).values():
        if isinstance(candidate, type) and issubclass(candidate, Estimator) and name in candidate.names:
            estimator: Estimator = candidate(name, facts, options)
            return estimator
    raise ConfigError("estimator has no implementation", where="estimator.name", found=name)
