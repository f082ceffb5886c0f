"""From ticks to model samples, and where an estimator has to begin anew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from canest.core.samples import ModelBlock
from canest.grid.grid import GridBlock
from canest.pipeline.assumed_constants import AssumedConstants, AssumedConstantsCheck
from canest.vehicle.filtered_model import FilteredModel
from canest.vehicle.spec import ModelSpec

if TYPE_CHECKING:
    from canest.road.matching import RoadMatcher
    from canest.road.table import RoadMap


class ModelStream:
    """Carries the model of one stream; what was learned with an assumed constant that was wrong is void."""

    def __init__(
        self,
        model: ModelSpec,
        assumed: AssumedConstants,
        *,
        excitation_gate: bool,
        road: RoadMap | None = None,
    ) -> None:
        self._filtered_model = FilteredModel(model, excitation_gate=excitation_gate)
        self._assumed = AssumedConstantsCheck(assumed)
        self._road = _matcher(road) if road is not None else None
        self._learned = False
        #: role -> ticks on which it closed the gate `stale`
        self.stale_ticks = self._filtered_model.stale_ticks
        #: role -> ticks on which the sensor was stuck (see `StuckSensor`)
        self.stuck_ticks = self._filtered_model.stuck_sensor.stuck_ticks

    def road_ahead(self) -> tuple[list[float], list[float]] | None:
        """Return distances from the vehicle and grades there; None without a map."""
        return self._road.ahead() if self._road is not None else None

    def process(self, ticks: GridBlock) -> Iterator[tuple[ModelBlock, bool]]:
        """Yield samples, in parts, and whether estimators must begin anew before each (`carry_over`)."""
        for part, contradicted in self._assumed.parts(ticks):
            anew = contradicted and self._learned
            block = self._filtered_model.process(replace(part, continues=False) if anew else part)
            if self._road is not None:
                sine, std = self._road.match(part, block)
                block = replace(block, road_sine=sine, road_std=std)
            self._learned = self._learned or not block.gate.all()
            yield block, anew


def _matcher(road: RoadMap) -> RoadMatcher:
    from canest.road.matching import RoadMatcher  # only a config with a map has one

    return RoadMatcher(road)
