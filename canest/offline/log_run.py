"""One pass of one log through one pipeline, streamed: memory does not grow with the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from canest.core.columns import stretches
from canest.core.frames import FrameBlock
from canest.core.samples import EstimateBlock, ModelBlock
from canest.core.table_block import TableBlock
from canest.doctor.facts import FactsCheck
from canest.doctor.mass_jump import MassJump
from canest.doctor.past_contradiction import PastContradiction
from canest.doctor.unmapped_groups import UnmappedGroups
from canest.logs.memory import MemoryLog
from canest.offline.reported_masses import ReportedMasses
from canest.pipeline.pipeline import Listener, Pipeline, TickListener
from canest.pipeline.table_map import TableMap, open_for

if TYPE_CHECKING:
    from canest.config import Config
    from canest.core.estimates import Estimates
    from canest.logs.base import LogReader

Progress = Callable[[int, int], None]  #: bytes done, bytes in all (0: unknown)

#: of a log in one go: what is taken of memory grows with the ticks, however few frames or rows they have
STRETCH_US = 600_000_000


class LogRun:
    """One pass of one log through one pipeline.

    Errors: LogError for what is no log, or is of a kind that the config has no signals for.
    """

    def __init__(
        self,
        log: str | Path | MemoryLog,
        config: Config,
        *,
        listeners: Sequence[Listener] = (),
        tick_listener: TickListener | None = None,
        channel: str | None = None,
        reported: ReportedMasses | None = None,
        facts: FactsCheck | None = None,
    ) -> None:
        self.config = config
        self._reported = reported
        heard = facts.push if facts is not None else None
        self.mass_jump = MassJump()
        self._listeners = (self.mass_jump, *listeners)
        self.pipeline = Pipeline(
            config, listener=self._listen, tick_listener=tick_listener, sample_listener=heard
        )
        self.past_contradiction, self.unmapped_groups = PastContradiction(), UnmappedGroups(config)
        self.table_map = TableMap(config, log)
        self.reader: LogReader = open_for(config, log, channel)

    def estimates(self, progress: Progress | None = None) -> Iterator[Estimates]:
        """Yield the estimates, in blocks (none of them empty)."""
        for block in self.reader:
            yield from filter(len, self._taken(block))
            self.past_contradiction.note(self.pipeline.estimator.contradiction())
            if progress is not None:
                progress(self.reader.bytes_done, self.reader.bytes_total)
        estimates = self.pipeline.finish()
        if len(estimates):
            yield estimates

    def _listen(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        for listener in self._listeners:
            listener(samples, estimates)

    def _taken(self, block: FrameBlock | TableBlock) -> Iterator[Estimates]:
        """Yield the estimates of a block's stretches: a block of slow signals may be hours of ticks."""
        if isinstance(block, FrameBlock):
            if self._reported is not None:
                self._reported.push(block)
            self.unmapped_groups.push(block)
            for part in stretches(block.t_us, STRETCH_US):
                yield self.pipeline.push(block[part])
            return
        samples = self.table_map.samples(block)
        if self._reported is not None:
            self._reported.push_samples(samples)
        for part in stretches(block.t_us, STRETCH_US):
            parts = {role: (t_us[part], values[part]) for role, (t_us, values) in samples.items()}
            yield self.pipeline.push_samples(parts, block.t_us[part])
