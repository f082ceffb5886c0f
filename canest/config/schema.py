"""The whole config: all its sections, and what they must agree on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, PrivateAttr, model_validator

from canest.config.agreement import refuse_contradictions
from canest.config.bus import Broadcast, Bus
from canest.config.databases import Databases
from canest.config.origins import Origins
from canest.config.road_map import KeptRoadMap
from canest.config.sections import EstimatorSection, FilterSection, Sampling, Service, Source
from canest.core.errors import ConfigError
from canest.core.section import MisplacedError, Section, empty_section
from canest.vehicle.facts import Vehicle
from canest.vehicle.gate_settings import Gates

if TYPE_CHECKING:
    from cantools.database.can import Database

    from canest.road.table import RoadMap


_SHOWN = 80  #: characters of a wrong source in a message


def _named(signals: object) -> object:
    """Leave out roles that are set to nothing: `--set signals.altitude=null` takes a signal away."""
    if isinstance(signals, dict):
        for role, source in signals.items():
            if isinstance(source, str):
                raise MisplacedError(f"found {source[:_SHOWN]!r}, expected {_form(source)}", str(role))
        return {role: source for role, source in signals.items() if source is not None}
    return signals


def _form(written: str) -> str:
    """Return how a source is written that somebody named by a word."""
    message, dot, signal = written.partition(".")
    if not (dot and message.isidentifier() and signal.isidentifier()):
        message, signal = "MESSAGE", "SIGNAL"
    return f"{{message: {message}, signal: {signal}}} of a DBC, or {{column: NAME}} of a table"


class Config(Section):
    """A whole config."""

    _origins: Origins = PrivateAttr(default_factory=Origins)
    _databases: Databases = PrivateAttr(default_factory=Databases)
    _road: KeptRoadMap = PrivateAttr(default_factory=KeptRoadMap)

    vehicle: Vehicle
    dbc: tuple[str, ...] = ("j1939.dbc",)
    signals: Annotated[dict[str, Source], BeforeValidator(_named)]
    sampling: Sampling = empty_section()
    filter: FilterSection = empty_section()
    gates: Gates = empty_section()
    estimator: EstimatorSection = empty_section()
    #: grade that earlier drives found, a file of `canest map build`
    road_map: str | None = None
    effects: tuple[dict[str, Any], ...] = ()
    bus: Bus = empty_section()
    broadcast: Broadcast = empty_section()
    service: Service = empty_section()

    def note_origins(self, origins: Origins) -> None:
        """Keep where keys were written, for messages."""
        self._origins = origins

    @property
    def file(self) -> str:
        """The file that it was read from, "" for none."""
        return self._origins.file

    def with_databases(self, databases: Sequence[Database]) -> Config:
        """Return the same config with the databases of its `dbc` beside it, in that order.

        A config that was loaded from a file has them; `canest.config.read_databases` reads them from files.
        """
        config = self.model_copy()
        config._databases = Databases(self.dbc, databases)
        return config

    def with_road(self, road: RoadMap | None) -> Config:
        """Return the same config with the map of its `road_map` beside it."""
        config = self.model_copy()
        config._road = KeptRoadMap(self.road_map, road)
        return config

    @property
    def road(self) -> RoadMap | None:
        """The map of `road_map`, as it was when it was read; None without one.

        Errors: ConfigError where there is one that has not been read.
        """
        if self.road_map is not None and (self._road.name != self.road_map or self._road.road is None):
            raise ConfigError(
                "it has not been read",
                where=self.at("road_map"),
                expected="a config of load_config or with_road",
            )
        return self._road.road if self.road_map is not None else None

    @property
    def databases(self) -> list[Database]:
        """The databases of `dbc`, as they were when they were read.

        A daemon makes its pipeline anew after a defect, or when a number proves wrong, and must not depend on
        files that somebody is replacing meanwhile; who wants what is in them now loads the config anew.
        Errors: ConfigError where a signal needs one and none have been read.
        """
        kept = self._databases
        if kept.names != self.dbc and self.dbc and any(s.message for s in self.signals.values()):
            raise ConfigError(
                "its databases have not been read",
                where=self.at("dbc"),
                expected="a config of load_config, read_databases or with_databases",
            )
        return kept.databases if kept.names == self.dbc else []

    def at(self, key: str) -> str:
        """Return a key behind the place where it was written: "truck.yaml:31: signals.gear"."""
        return ": ".join(part for part in (self._origins.of(tuple(key.split("."))), key) if part)

    @model_validator(mode="after")
    def _sections_agree(self) -> Config:
        refuse_contradictions(self.vehicle, self.signals, self.estimator, self.effects)
        return self
