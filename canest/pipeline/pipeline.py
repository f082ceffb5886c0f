"""The one way through: frames -> decode -> grid -> model, filter, gates -> estimator -> estimates.

Knows no socket, file, wall clock or thread. Daemon and replay are thin shells around it, and give the same
bits for the same frames however they are cut; comparison and diagnosis put its parts together for many
estimators, or many models, on frames that are decoded once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from canest.config.schema import Config
from canest.core.estimates import Estimates
from canest.core.frames import FloatColumn, FrameBlock, IntColumn
from canest.core.gates import LABELS, Gate
from canest.core.samples import EstimateBlock, ModelBlock
from canest.decode.decoder import Decoder
from canest.estimators.contract import updated
from canest.estimators.doubted_lever import widened_std_kg
from canest.estimators.status import none_begins
from canest.grid.clock import Clock
from canest.grid.grid import Feed, Grid, GridBlock
from canest.pipeline.assumed_constants import carry_over
from canest.pipeline.build import build
from canest.pipeline.intake import Intake, SampleListener
from canest.pipeline.model_stream import ModelStream


class Listener(Protocol):
    """Someone who wants the model samples beside the estimates (report, recorder of the daemon)."""

    def __call__(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the next samples and their estimates."""


class TickListener(Protocol):
    """Someone who wants what the roles of the signal map were at every tick (the fleet's tables)."""

    def __call__(self, ticks: GridBlock) -> None:
        """Take the next ticks; their samples follow."""


class Pipeline:
    """Carries every stage's state for one stream."""

    def __init__(
        self,
        config: Config,
        *,
        listener: Listener | None = None,
        tick_listener: TickListener | None = None,
        sample_listener: SampleListener | None = None,
    ) -> None:
        self._spec = spec = build(config)
        self.intake = Intake(spec.intake, sample_listener)
        self._grid = Grid(spec.grid.channels, spec.grid.hold_us)
        self.estimator = spec.estimator.create()
        gate = self.estimator.wants_excitation_gate
        self._model = ModelStream(spec.model, spec.assumed, excitation_gate=gate, road=spec.road)
        self._listener, self._tick_listener = listener, tick_listener
        self._restored: tuple[float, float, float] | None = None
        self._was_valid = False
        self._mass_kg = math.nan
        self._lever_std = 0.0
        self.gates: Counter[str] = Counter()
        self.samples = 0

    def push(self, frames: FrameBlock) -> Estimates:
        """Take the next frames; return the estimates of every tick they complete."""
        return self._take(self.intake.frames(frames))

    def push_samples(
        self, samples: Mapping[str, tuple[IntColumn, FloatColumn]], t_us: IntColumn
    ) -> Estimates:
        """Take already decoded samples (tables) with the stamps of all their rows, in order."""
        return self._take(self.intake.table(samples, t_us))

    def take_ticks(self, blocks: Iterable[GridBlock]) -> Estimates:
        """Take ticks that somebody else has made (the diagnosis runs one drive many times)."""
        done: list[Estimates] = []
        for ticks in blocks:
            self._emit(ticks, done)
        return Estimates.concatenate(done)

    def advance_to(self, t_us: int) -> Estimates:
        """Event time has certainly reached ``t_us``: emit ticks before it, though the bus may be quiet.

        Beyond the hold time after the last wanted frame nothing is emitted: ticks stop until the
        next one, exactly as a replay of the recording would.
        """
        done: list[Estimates] = []
        if self.clock.last_us is not None:
            end = min(t_us, self.clock.last_us + self._spec.grid.hold_us)
            self._emit(self._grid.ticks_until(end, inclusive=False), done)
        return Estimates.concatenate(done)

    def finish(self) -> Estimates:
        """Return the ticks that were still waiting for a later frame, at the end of a log."""
        done: list[Estimates] = []
        if self.clock.last_us is not None:
            self._emit(self._grid.ticks_until(self.clock.last_us, inclusive=True), done)
        return Estimates.concatenate(done)

    def restore(self, mass_kg: float, mass_std_kg: float, unseen_s: float = 0.0) -> None:
        """Start from a mass that was learned before a restart.

        unseen_s: time since then in which the load may have changed and nobody saw it.
        """
        self._restored = mass_kg, mass_std_kg, unseen_s
        self.estimator.restore(mass_kg, mass_std_kg, unseen_s)

    def snapshot(self) -> dict[str, Any]:
        """Return what the estimator wants to keep over a restart (JSON types)."""
        kept = self.estimator.snapshot()
        if kept and self._lever_std > 0.0:
            std_kg = widened_std_kg(kept["mass_std_kg"], kept["mass_kg"], self._lever_std)
            kept["mass_std_kg"] = float(std_kg)
        return kept

    @property
    def decoder(self) -> Decoder:
        """Return the decoder (its counters show what the bus carried)."""
        return self.intake.decoder

    @property
    def clock(self) -> Clock:
        """Return the event clock (its counters show what it had to correct)."""
        return self.intake.clock

    @property
    def stuck_ticks(self) -> dict[str, int]:
        """Return, by role, the ticks on which a sensor stood still though the vehicle did not."""
        return dict(self._model.stuck_ticks)

    @property
    def stale_ticks(self) -> dict[str, int]:
        """Return, by role, the ticks on which it closed the gate `stale`; of speeds, where none was fresh."""
        return dict(self._model.stale_ticks)

    def road_ahead(self) -> tuple[list[float], list[float]] | None:
        """Return distances from the vehicle (m) and the map's grades there; None without a map."""
        return self._model.road_ahead()

    @property
    def gate_counts(self) -> dict[str, int]:
        """Return samples refused per gate, by name."""
        return {name: self.gates[name] for name in LABELS.values() if name and self.gates[name]}

    @property
    def updated(self) -> int:
        """Return how many samples the estimator learned from."""
        return self.gates[""]

    def _take(self, feeds: Iterable[Feed]) -> Estimates:
        done: list[Estimates] = []
        for feed in feeds:
            for ticks in self._grid.take(feed):
                self._emit(ticks, done)
        return Estimates.concatenate(done)

    def _emit(self, ticks: GridBlock | None, done: list[Estimates]) -> None:
        if ticks is None:
            return
        if self._tick_listener is not None:
            self._tick_listener(ticks)
        for samples, anew in self._model.process(ticks):
            if anew:
                self.estimator = carry_over(self._spec.estimator.create(), self._mass_kg, self._restored)
            self._estimate(samples, done)

    def _estimate(self, samples: ModelBlock, done: list[Estimates]) -> None:
        e = updated(self.estimator, samples)
        status, self._was_valid = none_begins(e.status, samples.gate == Gate.STALE, self._was_valid)
        e = replace(e, status=status)
        if self._listener is not None:
            self._listener(samples, e)
        counts = np.bincount(samples.gate).tolist()
        for code, count in enumerate(counts):
            if count:
                self.gates[LABELS[code]] += count
        self.samples += len(samples)
        self._mass_kg = float(e.mass_kg[-1])
        if samples.lever_std is not None:
            self._lever_std = float(samples.lever_std[-1])
        done.append(
            Estimates(samples.t_us, e.mass_kg, e.mass_std_kg, e.grade, e.grade_std, e.status, samples.gate)
        )
