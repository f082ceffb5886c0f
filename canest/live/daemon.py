"""The daemon: a thin loop around the pure pipeline.

On beats 20 ms apart, as often as the interface's buffer asks for: empty it into ours. Before every broadcast,
and at least four times a second: estimate and speak. Once a second: look after everything else.
Nothing in the loop waits for the bus, the disk or a reader of its output.
"""

from __future__ import annotations

import gc
import os
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

from canest.bus.late_frames import restamp_late_frames
from canest.config.schema import Config
from canest.core.errors import CanestError
from canest.core.frames import FrameBlock
from canest.core.samples import EstimateBlock, ModelBlock
from canest.live.memory import Memory
from canest.live.outputs import Outputs
from canest.live.reload import ConfigReloader, Prepared, renew
from canest.live.schedule import Schedule
from canest.node.broadcast import FRESH_US
from canest.node.estimate_frame import Estimate
from canest.node.node import join
from canest.pipeline.pipeline import Estimates, Pipeline
from canest.system.files import Background
from canest.system.journal import Journal
from canest.system.systemd_notify import Notifier
from canest.telemetry.endpoints import Endpoints
from canest.telemetry.frame_rates import Rates
from canest.telemetry.sender_rates import SenderRateMonitor
from canest.telemetry.snapshot import flat, one_line, snapshot
from canest.telemetry.state_changes import Changes

CHORES_S = 1.0
METRICS_S = 10.0
#: estimates are at most this old when nobody is told more often; a little more than the period of the default
#: broadcast, so that its beat sets the sender
LONGEST_WAIT_US = 230_000
CLOSE_S = 0.5  #: SIGTERM has to be over within a second, whatever the disk does
#: errors inside the estimation are survived by starting the pipeline anew; this many in a row are not
MOST_FAILURES_IN_A_ROW = 5


class Daemon:
    """One bus, one vehicle, until it is stopped.

    config_name: where the config came from; reload: reads it again (SIGHUP).
    Errors: BusError, ConfigError when it cannot begin; later nothing short of a defect in canest ends it.
    """

    def __init__(
        self,
        config: Config,
        *,
        config_name: str = "config",
        reload: Callable[[], Config] | None = None,
        journal: Journal | None = None,
        notifier: Notifier | None = None,
    ) -> None:
        self.config, self.config_name, self.reloads = config, config_name, ConfigReloader(reload)
        self.journal = journal or Journal()
        self.notifier = notifier or Notifier()
        self.pid = os.getpid()
        self.schedule, self.rates, self.sender_rates = Schedule(), Rates(), SenderRateMonitor()
        self.started_us = time.monotonic_ns() // 1000
        self.background = Background()
        self.late_frames = self.failures = 0
        self._failures_in_a_row = 0
        self._stop = threading.Event()
        self._wants_reload = self._wants_snapshot = False
        self._latest: tuple[Estimate, int] | None = None
        self._standing = False
        self._reached_us = -(1 << 62)
        self._due_us = 0
        self._metrics_at_s = self._save_at_s = self._chores_at_s = 0.0
        self.endpoints: Endpoints | None = None
        self.pipeline = Pipeline(config, listener=self._listen)
        self.memory = Memory(config, self.background, self.journal)
        self.memory.restore(self.pipeline)
        self.receiver, self.node = join(config, self.pipeline.decoder.can_filters())
        self._opened = self.receiver.opened
        self.outputs = Outputs(config, self.background)
        self._changes = Changes(self)

    # -- life ---------------------------------------------------------------------------------------

    def run(self, *, handle_signals: bool = True) -> None:
        """Work until `stop` (or SIGTERM, SIGINT)."""
        if handle_signals:
            self._install_signals()
        try:
            self.endpoints = Endpoints(self.config, self.journal, self.background)
        except CanestError:  # a daemon of this config runs already: nothing has been sent yet
            self.receiver.close()
            raise
        self.journal.notice(
            "started",
            config=self.config_name,
            bus=f"{self.config.bus.interface}:{self.config.bus.channel}",
            estimator=self.config.estimator.name,
            broadcast=self.node.silence_reason(self.started_us) or "on",
        )
        self.notifier.ready()
        gc.collect()
        gc.freeze()  # what is here now lives as long as we do: later collections need not look at it
        try:
            while not self._stop.is_set():
                self.beat()
        finally:
            self._end()

    def stop(self) -> None:
        """End the loop at its next tick (from any thread or signal handler)."""
        self._stop.set()

    def estimate(self, now_us: int) -> Estimate:
        """Return the newest estimate, "not available" when it is not of now."""
        if self._latest is None or now_us - self._latest[1] > FRESH_US:
            return Estimate()
        return self._latest[0]

    # -- the loop -----------------------------------------------------------------------------------

    def beat(self) -> None:
        """Sleep as long as nothing is due and the interface can be left alone; then do what is due."""
        now_ns = self.schedule.wait(self.schedule.until(self._due_us, self.receiver.max_poll_interval_us))
        now_us, now_s = now_ns // 1000, now_ns * 1e-9
        if now_us >= self._due_us or not self.receiver.collect():
            self._work(now_us, now_s)
            self._due_us = min(now_us + LONGEST_WAIT_US, self.node.due_us(now_us))
        if now_s >= self._chores_at_s:
            self._chores_at_s = now_s + CHORES_S
            self._chores(now_us, now_s)
        if self.reloads.under_way:
            self._end_reload(now_s)
        self.rates.count(time.thread_time_ns())

    def _work(self, now_us: int, now_s: float) -> None:
        """Bring everything up to date with what has arrived, and say what is due.

        However the frames are cut into blocks, the numbers are the same; so this runs when somebody is
        about to be told, and what lies between is done in one go.
        """
        drained = self.receiver.drain()
        if self.receiver.opened != self._opened:
            self._opened = self.receiver.opened
            self.node.restart(now_us)
        back_s = self.config.sampling.max_backward_s
        frames, late = restamp_late_frames(drained.frames, self._reached_us, back_s)
        self.late_frames += late
        if len(frames):
            self.rates.frames += len(frames)
            self.node.observe(frames, now_us)
            self.outputs.frames(frames, now_s)
        try:
            self._estimate(frames, drained.reached_us, now_us, now_s)
            self._failures_in_a_row = 0
        except Exception as error:  # a defect of ours; the vehicle drives on, and so do we
            self._survive(error)
        self.node.send_due(now_us)
        self.notifier.ping_watchdog(now_s)

    def _estimate(self, frames: FrameBlock, reached_us: int | None, now_us: int, now_s: float) -> None:
        if len(frames):
            self._note(self.pipeline.push(frames), now_us, now_s)
        if reached_us is not None:
            self._reached_us = reached_us
            self._note(self.pipeline.advance_to(reached_us), now_us, now_s)

    def _note(self, estimates: Estimates, now_us: int, now_s: float) -> None:
        if not len(estimates):
            return
        last = Estimate(
            float(estimates.mass_kg[-1]),
            float(estimates.mass_std_kg[-1]),
            float(estimates.grade[-1]),
            float(estimates.grade_std[-1]),
            int(estimates.status[-1]),
            int(estimates.gate[-1]),
        )
        self._latest = last, now_us
        self.node.set_estimate(last, now_us)
        distance_km = self.node.monitor.odometer.confirmed_km
        self.memory.note(last.mass_kg, last.mass_std_kg, last.status, self._standing, distance_km)
        self.outputs.estimates(estimates, now_s)

    def _listen(self, samples: ModelBlock, estimates: EstimateBlock) -> None:
        self._standing = bool(samples.stopped[-1])
        self.node.monitor.odometer.add_driven(samples.raw_speed_mps)

    def _survive(self, error: Exception) -> None:
        self.failures += 1
        self._failures_in_a_row += 1
        if self._failures_in_a_row >= MOST_FAILURES_IN_A_ROW:
            raise error
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        where = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace else "?"
        self.journal.error("estimation-failed", error=f"{type(error).__name__}: {error}", where=where)
        self.pipeline = Pipeline(self.config, listener=self._listen)
        self.memory.initialise(self.pipeline)

    # -- once a second ------------------------------------------------------------------------------

    def _chores(self, now_us: int, now_s: float) -> None:
        self.rates.close(now_s)
        self.sender_rates.look(self.pipeline.decoder.counters, now_s)
        if self.endpoints is not None and self.endpoints.status is not None:
            self.endpoints.status.poll(lambda: snapshot(self, now_us))
        self.outputs.idle(now_s)
        self._changes.tell(now_us)
        self.notifier.status(one_line(self, now_us))
        if now_s >= self._save_at_s:
            if self._save_at_s:
                self.memory.save()
            self._save_at_s = now_s + self.config.service.save_every_s
        if now_s >= self._metrics_at_s:
            self._metrics_at_s = now_s + METRICS_S
            if self.outputs.wants_metrics:
                told = snapshot(self, now_us)
                self.outputs.write_metrics(told)
                if self.endpoints is not None:
                    self.endpoints.latest.update(told)
        if self._wants_snapshot:
            self._wants_snapshot = False
            self.journal.notice("counters", **flat(snapshot(self, now_us)))
        if self._wants_reload and not self.reloads.under_way:  # a signal meanwhile waits for its turn
            self._wants_reload = False
            if self.reloads.read is not None:
                self._begin_reload(now_s)

    # -- beginning, reload, end ---------------------------------------------------------------------

    def _begin_reload(self, now_s: float) -> None:
        self.notifier.reloading()
        try:
            self.reloads.begin(self.config, self.pipeline, self._listen, now_s)
        except Exception as error:  # no thread to be had, or one that hangs
            self._refuse_reload(error)

    def _end_reload(self, now_s: float) -> None:
        """Take a changed config over once it is read; a broken one changes nothing."""
        outcome = self.reloads.outcome(now_s)
        if isinstance(outcome, Exception):
            self._refuse_reload(outcome)
        elif outcome is not None:
            try:
                self._renew(outcome)
            except Exception as error:  # whatever is wrong with the new config, the old one stays in force
                self._refuse_reload(error)

    def _refuse_reload(self, error: Exception) -> None:
        self.reloads.note(str(error) or type(error).__name__)
        self.journal.error("reload-refused", error=self.reloads.refused_because)
        self.notifier.ready()

    def _renew(self, prepared: Prepared) -> None:
        new = renew(prepared, self.pipeline, self.endpoints)
        self.memory = self.memory.transferred(new.config, new.pipeline)
        self.config, self.pipeline = new.config, new.pipeline or self.pipeline
        if new.joined is not None:
            self.receiver.close()
            self.receiver, self.node = new.joined
            self._opened = self.receiver.opened
        self.outputs.close()
        self.outputs = Outputs(self.config, self.background)
        self.reloads.note("")
        self.journal.notice("reloaded", config=self.config_name)
        self.notifier.ready()

    def _install_signals(self) -> None:
        def on_signal(number: int, frame: FrameType | None) -> None:
            if number == signal.SIGHUP:
                self._wants_reload = True
            elif number == signal.SIGUSR1:
                self._wants_snapshot = True
            else:
                self.stop()

        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, on_signal)

    def _end(self) -> None:
        self.notifier.stopping()
        self.memory.save()
        self.outputs.close()
        if not self.background.close(CLOSE_S):
            self.journal.error("disk-hangs", lost="what was still to be written")
        self.receiver.close()
        if self.endpoints is not None:
            self.endpoints.close()
        self.journal.notice("stopped", frames=self.pipeline.decoder.counters.frames)
        self.notifier.close()
