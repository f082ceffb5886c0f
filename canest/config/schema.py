"""The whole config: all its sections, and what they must agree on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BeforeValidator, PrivateAttr, model_validator

from canest.config.agreement import refuse_contradictions
from canest.config.bus import Broadcast, Bus
from canest.config.files import ReadFiles
from canest.config.origins import Origins
from canest.config.sections import EstimatorSection, FilterSection, Sampling, Service, Source
from canest.core.section import Section, empty_section
from canest.vehicle.facts import Vehicle
from canest.vehicle.gate_settings import Gates


def _named(signals: object) -> object:
    """Leave out roles that are set to nothing: `--set signals.altitude=null` takes a signal away."""
    if isinstance(signals, dict):
        return {role: source for role, source in signals.items() if source is not None}
    return signals


class Config(Section):
    """A whole config."""

    _origins: Origins = PrivateAttr(default_factory=Origins)
    _files: ReadFiles = PrivateAttr(default_factory=ReadFiles)

    vehicle: Vehicle
    dbc: tuple[str, ...] = ("j1939.dbc",)
    signals: Annotated[dict[str, Source], BeforeValidator(_named)]
    sampling: Sampling = empty_section()
    filter: FilterSection = empty_section()
    gates: Gates = empty_section()
    estimator: EstimatorSection = empty_section()
    effects: tuple[dict[str, Any], ...] = ()
    bus: Bus = empty_section()
    broadcast: Broadcast = empty_section()
    service: Service = empty_section()

    def note_origins(self, origins: Origins) -> None:
        """Remember where keys were written, for messages."""
        self._origins = origins

    def read_once(self, read: Callable[[str, str], Any]) -> list[Any]:
        """Return what ``read`` makes of each file under `dbc` (its name, its place in the config), once."""
        kept = self._files.kept
        if self.dbc not in kept:
            kept[self.dbc] = [read(name, self.at(f"dbc.{i}")) for i, name in enumerate(self.dbc)]
        return kept[self.dbc]

    def at(self, key: str) -> str:
        """Return a key behind the place where it was written: "truck.yaml:31: signals.gear"."""
        return ": ".join(part for part in (self._origins.of(tuple(key.split("."))), key) if part)

    @model_validator(mode="after")
    def _sections_agree(self) -> Config:
        refuse_contradictions(self.vehicle, self.signals, self.estimator, self.effects)
        return self
