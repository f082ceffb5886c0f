"""Received frames into the pipeline, and its newest estimate out; an error inside it is survived.

However the frames are cut into blocks, the estimates are the same to the last bit, so `update` runs only
when an estimate is about to be sent, and does what lies between in one go.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from canest.bus.late_frames import restamp_late_frames
from canest.config.schema import Config
from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.core.samples import EstimateBlock, ModelBlock
from canest.doctor.stretches import Samples
from canest.live.mass_store import MassStore
from canest.live.notes import Notes
from canest.node.broadcast import FRESH_US
from canest.node.estimate_frame import Estimate
from canest.node.odometer import Odometer
from canest.pipeline.pipeline import Pipeline
from canest.system.journal import Journal
from canest.telemetry.daemon_view import LastEstimate
from canest.telemetry.live_rows import LiveRows

#: an error inside the pipeline is survived by starting it anew; this many in a row are not
MOST_FAILURES_IN_A_ROW = 5

Publish = Callable[[Estimates, Estimate], None]  #: takes new estimates and the last of them


class Estimation:
    """The pipeline of the config in force, the mass it has learned, and its newest estimate.

    odometer: compares its senders with the speed of the pipeline's samples; the node's, once there is one.
    late_frames: restamped by the late-frame policy. failures: errors survived. live_rows: for live views.
    notes: what contradicts the config.
    """

    def __init__(self, config: Config, mass_store: MassStore, journal: Journal) -> None:
        self.config, self.mass_store, self._journal = config, mass_store, journal
        self.notes = Notes(config, journal)
        self.pipeline = self.new_pipeline(config)
        self.odometer = Odometer()
        self.live_rows = LiveRows()
        self.late_frames = self.failures = 0
        self._failures_in_a_row = 0
        self._newest: tuple[Estimate, int] | None = None
        self._last_mass: tuple[Estimate, int] | None = None
        self._standing = False
        self._reached_us = -(1 << 62)
        mass_store.restore(self.pipeline)

    def restamp(self, frames: FrameBlock) -> FrameBlock:
        """Apply the late-frame policy to received frames, and count the late ones."""
        back_s = self.config.sampling.max_backward_s
        frames, late = restamp_late_frames(frames, self._reached_us, back_s)
        self.late_frames += late
        return frames

    def update(self, frames: FrameBlock, reached_us: int | None, now_us: int, publish: Publish) -> None:
        """Estimate from frames, up to the event time ``reached_us`` (None: not known).

        now_us: monotonic. publish: called with every block of estimates.
        Errors: the last of `MOST_FAILURES_IN_A_ROW` errors inside the pipeline, of any type.
        """
        try:
            if len(frames):
                self._hand_over(self.pipeline.push(frames), now_us, publish)
            if reached_us is not None:
                self._reached_us = reached_us
                self._hand_over(self.pipeline.advance_to(reached_us), now_us, publish)
            self._failures_in_a_row = 0
        except Exception as error:  # a defect of ours; the vehicle drives on, and so do we
            self._restart(error)

    def is_current(self, now_us: int) -> bool:
        """Return whether there is an estimate of now."""
        return self._newest is not None and now_us - self._newest[1] <= FRESH_US

    def current(self, now_us: int) -> Estimate:
        """Return the newest estimate, "not available" when it is not of now."""
        return self._newest[0] if self._newest is not None and self.is_current(now_us) else Estimate()

    def last(self, now_us: int) -> LastEstimate | None:
        """Return the newest estimate that had a mass, whatever its age; None while there is none."""
        if self._last_mass is None:
            return None
        estimate, then_us = self._last_mass
        return LastEstimate(estimate, (now_us - then_us) * 1e-6)

    def reconfigure(self, config: Config, pipeline: Pipeline | None) -> None:
        """Go on under a changed config. pipeline: the new one, None to keep the present one."""
        self.mass_store = self.mass_store.transferred(config, pipeline)
        if pipeline is not None:
            self.notes = Notes(config, self._journal)
        self.config, self.pipeline = config, pipeline or self.pipeline

    def new_pipeline(self, config: Config) -> Pipeline:
        """Return a pipeline that hands its samples to this."""
        return Pipeline(config, listener=self.listen, sample_listener=self.hear)

    def listen(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        """Take the model samples of a pipeline (its `Listener`)."""
        self._standing = bool(samples.stopped[-1])
        self.odometer.add_driven(samples.raw_speed_mps)
        self.live_rows.add(samples, estimates)
        self.notes.listen(samples, estimates)

    def hear(self, samples: Samples) -> None:
        """Take the decoded samples of a pipeline (its `SampleListener`)."""
        self.notes.push(samples)

    def _hand_over(self, estimates: Estimates, now_us: int, publish: Publish) -> None:
        if not len(estimates):
            return
        newest = Estimate(
            float(estimates.mass_kg[-1]),
            float(estimates.mass_std_kg[-1]),
            float(estimates.grade[-1]),
            float(estimates.grade_std[-1]),
            int(estimates.status[-1]),
            int(estimates.gate[-1]),
        )
        self._newest = newest, now_us
        if math.isfinite(newest.mass_kg):
            self._last_mass = self._newest
        self.mass_store.update(
            newest.mass_kg, newest.mass_std_kg, newest.status, self._standing, self.odometer.confirmed_km
        )
        publish(estimates, newest)

    def _restart(self, error: Exception) -> None:
        """Start the pipeline anew from the mass learned so far."""
        self.failures += 1
        self._failures_in_a_row += 1
        if self._failures_in_a_row >= MOST_FAILURES_IN_A_ROW:
            raise error
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        where = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace else "?"
        self._journal.error("estimation-failed", error=f"{type(error).__name__}: {error}", where=where)
        self.pipeline = self.new_pipeline(self.config)
        self.mass_store.initialise(self.pipeline)
