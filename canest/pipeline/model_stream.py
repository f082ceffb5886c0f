"""From ticks to model samples, and where an estimator has to begin anew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from canest.config.schema import Config
from canest.core.samples import ModelBlock
from canest.grid.grid import GridBlock
from canest.pipeline.assumed_constants import StandIns
from canest.vehicle.model_samples import Regression


class ModelStream:
    """Carries the model of one stream; what was learned with a number that is refuted is void."""

    def __init__(self, config: Config, *, excitation_gate: bool) -> None:
        self._regression = Regression(config, excitation_gate=excitation_gate)
        self._stand_ins = StandIns(config)
        self._learned = False
        #: role -> ticks on which it was frozen (see `Frozen`)
        self.frozen = self._regression.frozen.counts

    def process(self, ticks: GridBlock) -> Iterator[tuple[ModelBlock, bool]]:
        """Yield samples, in parts, and whether estimators must begin anew before each (`doubting`)."""
        for part, refuted in self._stand_ins.parts(ticks):
            anew = refuted and self._learned
            block = self._regression.process(replace(part, continues=False) if anew else part)
            self._learned = self._learned or not block.gate.all()
            yield block, anew
