"""A drive decoded once and kept, so that the model can be run on it again with any effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from canest.config.schema import Config
from canest.core.errors import LogError
from canest.core.estimates import Estimates
from canest.core.frames import BoolColumn, FloatColumn, MonotonicClock
from canest.core.samples import STEP_US, ModelBlock
from canest.core.table_block import TableBlock
from canest.doctor.config_warnings import config_warnings
from canest.doctor.facts import FactsCheck
from canest.doctor.missing_signals import missing_signal_warnings
from canest.doctor.reasons import why_no_time
from canest.doctor.unmapped_groups import UnmappedGroups
from canest.doctor.warnings import stream_warnings
from canest.grid.grid import Feed, Grid, GridBlock
from canest.logs.log_names import log_name
from canest.logs.log_warnings import log_warnings
from canest.logs.memory import MemoryLog
from canest.pipeline.build import grid_spec, intake_spec, model_spec
from canest.pipeline.intake import Intake
from canest.pipeline.pipeline import Pipeline
from canest.pipeline.table_map import TableMap, open_for
from canest.vehicle.butterworth import Filter
from canest.vehicle.effects import Effect
from canest.vehicle.filtered_model import FilteredModel


@dataclass(frozen=True)
class Run:
    """The model's output for a whole drive, and the raw signals behind it (roles held on the ticks).

    behind_s: every tick shows the vehicle as it was so long before (what is reported late is waited for).
    """

    samples: ModelBlock
    torque_Nm: FloatColumn
    engine_radps: FloatColumn
    gear: FloatColumn
    signals: dict[str, FloatColumn]
    behind_s: float = 0.0

    @property
    def t_s(self) -> FloatColumn:
        """Seconds that had passed since the first tick, whatever the log's clock was set to (n,)."""
        return np.asarray((MonotonicClock()(self.samples.t_us) - self.samples.t_us[0]) * 1e-6)

    @property
    def begins(self) -> BoolColumn:
        """Where the run begins, or goes on after a gap of the log (n,)."""
        t_us = self.samples.t_us
        return np.asarray(np.diff(t_us, prepend=t_us[:1]) != STEP_US)

    @property
    def open(self) -> BoolColumn:
        """Where the gates are open."""
        return np.asarray(self.samples.gate == 0)


class NothingToDiagnoseError(LogError):
    """The log can be read, but holds nothing that the model could be run on."""


class Drive:
    """One log's decoded samples with the config they were decoded by."""

    def __init__(
        self,
        path: Path | MemoryLog,
        config: Config,
        feeds: Sequence[Feed],
        flaw: str = "",
        notes: Sequence[str] = (),
        channel: str | None = None,
    ) -> None:
        self.path, self.config, self._feeds, self._flaw = path, config, feeds, flaw
        self.notes = list(notes)  #: what a user should know of the log beside the numbers
        self.channel = channel  #: the one interface of the log that was read, None for all
        self.name = path.name if isinstance(path, MemoryLog) else log_name(path)
        self._grids: dict[tuple[float, ...], list[GridBlock]] = {}

    @staticmethod
    def load(path: Path | MemoryLog, config: Config, channel: str | None = None) -> Drive:
        """Read and decode a log (frames or table). Errors: LogError, NothingToDiagnoseError."""
        facts, groups = FactsCheck(config), UnmappedGroups(config)
        intake = Intake(intake_spec(config), facts.push)
        table = TableMap(config, path)
        feeds: list[Feed] = []
        reader = open_for(config, path, channel)
        for block in reader:
            if isinstance(block, TableBlock):
                feeds.extend(intake.table(table.samples(block), block.t_us))
            else:
                groups.push(block)
                feeds.extend(intake.frames(block))
        if not feeds:
            what = "holds no frame that the config's signal map wants"
            raise NothingToDiagnoseError(what, where=str(path))
        notes = config_warnings(config, groups.came) + log_warnings(reader)
        notes += table.warnings() + stream_warnings(intake)
        notes += missing_signal_warnings(config, intake.received) + groups.hints()
        notes += facts.notes(intake)
        return Drive(path, config, feeds, why_no_time(intake.clock), notes, channel)

    @staticmethod
    def with_effects(config: Config, effects: Sequence[Effect]) -> Config:
        """Return the config with these effects in place of its own."""
        entries = tuple(e.to_config() for e in effects)
        return config.model_copy(update={"effects": entries})

    def run(self, effects: Sequence[Effect], *, config: Config | None = None) -> Run:
        """Run the model with exactly these effects (the config's own are not added)."""
        changed = self.with_effects(config or self.config, effects)
        regression = FilteredModel(model_spec(changed))
        parts: list[ModelBlock] = []
        raws: list[dict[str, Any]] = []
        for ticks in self._ticks(changed, effects):
            parts.append(regression.process(ticks))
            raw = regression.last_columns
            raws.append(
                {
                    "torque_Nm": raw.torque_Nm,
                    "engine_radps": raw.engine_radps,
                    "gear": raw.gear,
                    "signals": raw.signals,
                }
            )
        if not parts:
            raise NothingToDiagnoseError(
                self._flaw or "is too short: not one 20 ms tick", where=str(self.path)
            )
        columns = {k: np.concatenate([r[k] for r in raws]) for k in ("torque_Nm", "engine_radps", "gear")}
        signals = {role: np.concatenate([r["signals"][role] for r in raws]) for role in raws[0]["signals"]}
        behind_s = _grid(changed).behind_us * 1e-6
        return Run(ModelBlock.concatenate(parts), signals=signals, behind_s=behind_s, **columns)

    def estimate(self, effects: Sequence[Effect]) -> Estimates:
        """Run the config's estimator over the drive with exactly these effects."""
        changed = self.with_effects(self.config, effects)
        pipeline = Pipeline(changed)
        return pipeline.take_ticks(self._ticks(changed, effects))

    def filtered(self, column: FloatColumn, run: Run) -> FloatColumn:
        """Pass a column of the run's ticks through the model's Butterworth (for a reference)."""
        return Filter(self.config.filter.order, self.config.filter.cutoff_hz).apply(column, run.begins)

    def _ticks(self, config: Config, effects: Sequence[Effect]) -> list[GridBlock]:
        """Return the grid blocks, made anew only when an effect changes the sampling."""
        key = tuple(float(getattr(e, "delay_s", 0.0)) for e in effects if e.stage == "sampling")
        if key not in self._grids:
            grid = _grid(config)
            blocks = [b for feed in self._feeds for b in grid.take(feed)]
            # the plain one, and two delays: a value of it and the step beside that
            delayed = [k for k in self._grids if k]
            self._grids = {k: self._grids[k] for k in self._grids if k not in delayed[:-1]}
            self._grids[key] = _joined(blocks)
        return self._grids[key]


def _grid(config: Config) -> Grid:
    spec = grid_spec(config)
    return Grid(spec.channels, spec.hold_us)


def _joined(blocks: list[GridBlock]) -> list[GridBlock]:
    """Join runs of ticks that follow each other: one long block computes faster than many."""
    joined: list[list[GridBlock]] = []
    for block in blocks:
        if block.continues and joined:
            joined[-1].append(block)
        else:
            joined.append([block])
    return [
        GridBlock(
            np.concatenate([b.t_us for b in run]),
            {r: np.concatenate([b.values[r] for b in run]) for r in run[0].values},
            {r: np.concatenate([b.stale[r] for b in run]) for r in run[0].stale},
            run[0].continues,
        )
        for run in joined
    ]
