"""The pipeline's input stage: wanted frames (or table rows) in, monotone stretches of decoded samples out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from canest.core.frames import FloatColumn, FrameBlock, IntColumn
from canest.core.roles import LASTING
from canest.decode.decoder import Decoder
from canest.grid.clock import Clock, Stretch
from canest.grid.grid import Feed
from canest.pipeline.build import IntakeSpec
from canest.vehicle.range_rate_check import RangeRateCheck
from canest.vehicle.torque_dropout import TorqueDropoutCheck

#: someone who wants the samples as they were decoded, jumps included: role -> t_us, values (n,)
SampleListener = Callable[[dict[str, tuple[IntColumn, FloatColumn]]], None]


class Intake:
    """Selects, puts in time order, decodes, refuses jumps; carries the state of all that."""

    def __init__(self, spec: IntakeSpec, listener: SampleListener | None = None) -> None:
        self._listener = listener
        self.decoder = Decoder(spec.wants, spec.databases)
        self.clock = Clock(spec.hold_us, spec.max_backward_us)
        torque = {role: TorqueDropoutCheck(*limit) for role, limit in spec.torque.items()}
        self.range_rate_check = RangeRateCheck(spec.limits, spec.motion, torque)
        self.received: set[str] = set()  #: roles that have had a value

    def frames(self, block: FrameBlock) -> Iterator[Feed]:
        """Yield the stretches of a block of frames."""
        for stretch in self.clock.split(self.decoder.select(block)):
            t_us = stretch.frames.t_us
            samples = self.decoder.decode(stretch.frames).samples
            yield self._feed(samples, stretch, t_us)

    def table(self, samples: Mapping[str, tuple[IntColumn, FloatColumn]], t_us: IntColumn) -> Iterator[Feed]:
        """Yield the stretches of table rows: ``t_us`` of every row, and one value per row and role."""
        nothing = np.zeros(len(t_us), np.uint32)
        rows = FrameBlock(t_us, nothing, nothing.astype(np.uint8), np.arange(len(t_us), dtype=np.uint64))
        for stretch in self.clock.split(rows):
            stamps, at = stretch.frames.t_us, stretch.frames.data.astype(np.int64)
            # minus zero becomes zero: equal values are then equal bits, which the grid relies on
            part = {role: (stamps, value[at] + 0.0) for role, (_, value) in samples.items()}
            yield self._feed(part, stretch, stamps)

    def _feed(
        self, samples: Mapping[str, tuple[IntColumn, FloatColumn]], stretch: Stretch, t_us: IntColumn
    ) -> Feed:
        if stretch.jump == "back":
            self.range_rate_check.restart()
        if self._listener is not None:
            self._listener(dict(samples))
        kept = self.range_rate_check.apply(samples)
        self.received.update(r for r in kept.keys() - self.received if np.isfinite(kept[r][1]).any())
        for role in LASTING & kept.keys():
            stamps, values = kept[role]
            known = np.isfinite(values)
            if not known.all():
                kept[role] = stamps[known], values[known]
        return Feed(kept, stretch.jump, stretch.before_us, int(t_us[0]), int(t_us[-1]))
