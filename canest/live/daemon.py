"""The daemon: a thin loop around the pure pipeline.

On ticks 20 ms apart, as often as the interface's buffer requires: empty it into ours. Before every broadcast,
and at least four times a second: estimate and send. Once a second: everything else (`_work_once_a_second`).
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

from canest.bus.protocols import UP
from canest.config.schema import Config
from canest.core.errors import CanestError
from canest.core.estimates import Estimates
from canest.core.samples import STEP_US
from canest.doctor.config_warnings import config_warnings
from canest.live.estimation import Estimation
from canest.live.mass_store import MassStore
from canest.live.outputs import Outputs
from canest.live.reload import ConfigReloader, Prepared, replacement
from canest.live.reporting import Reporter
from canest.live.schedule import Schedule
from canest.node.estimate_frame import Estimate
from canest.node.node import join
from canest.pipeline.pipeline import Pipeline
from canest.system.files import Background
from canest.system.journal import Journal
from canest.system.systemd_notify import Notifier
from canest.telemetry.daemon_view import DaemonView, LearnedMass, ReloadCounts, TickCounts
from canest.telemetry.loop_rates import LoopRates
from canest.telemetry.sender_rates import SenderRateMonitor
from canest.telemetry.status_socket import refuse_second_daemon, socket_path

CHORES_S = 1.0  #: period of everything but receiving, estimating and sending
#: longest time between two estimates; a little more than the period of the default broadcast, so that its
#: due time sets the pace
LONGEST_WAIT_US = 230_000
#: the same where requests are answered (SAE J1939-21, Tr)
LONGEST_ANSWER_US = 200_000
_OBJECTS_BETWEEN_COLLECTIONS = 100_000  #: a look at as many takes 35 ms, and delays ticks by that
CLOSE_S = 0.5  #: SIGTERM has to be over within a second, whatever the disk does


class Daemon:
    """One bus, one vehicle, until it is stopped.

    config_name: where the config came from; reload: reads it again (SIGHUP).
    Errors: BusError, ConfigError, UsageError when it cannot begin; later only a defect in canest ends it.
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
        self.config, self.config_name, self.pid = config, config_name, os.getpid()
        self.journal, self.notifier = journal or Journal(), notifier or Notifier()
        self.reloads = ConfigReloader(reload, self.journal, self.notifier)
        self.schedule, self.rates, self.sender_rates = Schedule(), LoopRates(), SenderRateMonitor()
        self.started_us = time.monotonic_ns() // 1000
        self.background = Background()
        self.reporter = Reporter(self.journal, self.notifier, self.background)
        self._stop = threading.Event()
        self._reload_requested = self._counters_requested = False
        self._due_us = 0
        self._frames_us: int | None = None
        self._save_at_s = self._chores_at_s = 0.0
        refuse_second_daemon(socket_path(config))  # before the state file of one that runs is touched
        mass_store = MassStore(config, self.background, self.journal)
        self.estimation = Estimation(config, mass_store, self.journal)
        self.estimation.live_rows = self.reporter.live_rows
        self.receiver, self.node = join(config, self.pipeline.decoder.can_filters())
        self.estimation.odometer = self.node.monitor.odometer
        self._opened = self.receiver.opened
        self._bus_state = self.receiver.state
        self.outputs = Outputs(config, self.background)

    # -- from start to end --------------------------------------------------------------------------

    def run(self, *, handle_signals: bool = True) -> None:
        """Work until `stop` (or SIGTERM, SIGINT)."""
        if handle_signals:
            self._install_signals()
        try:
            self.reporter.open(self.config)
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
        self._log_notes()
        self.notifier.ready()
        gc.collect()
        gc.freeze()  # what is here now lives as long as we do: later collections need not examine it
        gc.set_threshold(min(gc.get_threshold()[0], _OBJECTS_BETWEEN_COLLECTIONS))
        try:
            while not self._stop.is_set():
                self.step()
        finally:
            self.close()

    def stop(self) -> None:
        """End the loop at its next tick (from any thread or signal handler)."""
        self._stop.set()

    def request_reload(self) -> None:
        """Have the config read again within a second (from any thread or signal handler)."""
        self._reload_requested = True

    def request_counters(self) -> None:
        """Have all counters logged within a second (from any thread or signal handler)."""
        self._counters_requested = True

    def close(self) -> None:
        """Save what was learned and let everything go; `run` does so at its end."""
        self.notifier.stopping()
        self.estimation.mass_store.save()
        self.outputs.close()
        if not self.background.close(CLOSE_S):
            self.journal.error("disk-hangs", lost="what was still to be written")
        self.receiver.close()
        self.reporter.close()
        self.journal.notice("stopped", frames=self.pipeline.decoder.counters.frames)
        self.notifier.close()

    # -- state --------------------------------------------------------------------------------------

    @property
    def pipeline(self) -> Pipeline:
        """Return the pipeline in force; a reload or an error inside it brings another one."""
        return self.estimation.pipeline

    def estimate(self, now_us: int) -> Estimate:
        """Return the newest estimate, "not available" when it is not of now."""
        return self.estimation.current(now_us)

    def view(self, now_us: int) -> DaemonView:
        """Return what status, metrics and the log report on, at ``now_us`` (monotonic)."""
        saved = self.estimation.mass_store.learned
        learned = None
        if saved is not None:
            learned = LearnedMass(saved.mass_kg, saved.mass_std_kg, saved.saved_s, saved.distance_km)
        return DaemonView(
            now_us=now_us,
            started_us=self.started_us,
            pid=self.pid,
            config=self.config,
            config_name=self.config_name,
            estimate=self.estimate(now_us),
            pipeline=self.pipeline,
            receiver=self.receiver,
            node=self.node,
            background=self.background,
            rates=self.rates,
            sender_rates=self.sender_rates,
            ticks=TickCounts(self.schedule.ticks, self.schedule.missed, self.schedule.share_within(0.5)),
            reloads=ReloadCounts(self.reloads.accepted, self.reloads.refused, self.reloads.refused_because),
            late_frames=self.estimation.late_frames,
            failures=self.estimation.failures,
            learned=learned,
            last=self.estimation.last(now_us),
            quiet_s=self._quiet_s(now_us),
            notes=self.estimation.notes.found,
            notes_logged=self.estimation.notes.logged,
        )

    def _quiet_s(self, now_us: int) -> float | None:
        return None if self._frames_us is None else (now_us - self._frames_us) * 1e-6

    # -- the loop -----------------------------------------------------------------------------------

    def step(self) -> None:
        """Sleep as long as nothing is due and the interface can be left alone; then do what is due."""
        ticks = self.schedule.ticks_until(self._due_us, self.receiver.max_poll_interval_us)
        now_ns = self.schedule.wait(ticks)
        now_us, now_s = now_ns // 1000, now_ns * 1e-9
        if now_us >= self._due_us or not self.receiver.collect():
            self._estimate_and_send(now_us, now_s)
            longest_us = LONGEST_WAIT_US if self.node.transmitter is None else LONGEST_ANSWER_US
            due_us = self.node.due_us(now_us)
            # a tick before, where it is not the broadcast that sets the pace
            self._due_us = due_us if due_us <= now_us + longest_us else now_us + longest_us - STEP_US
        if now_s >= self._chores_at_s:
            self._chores_at_s = now_s + CHORES_S
            self._work_once_a_second(now_us, now_s)
        if self.reloads.under_way:
            self._finish_reload(now_s)
        self.rates.count_tick(time.thread_time_ns())

    def _estimate_and_send(self, now_us: int, now_s: float) -> None:
        """Process the frames that have arrived, and send what is due."""
        drained = self.receiver.drain()
        state, before = self.receiver.state, self._bus_state
        if self.receiver.opened != self._opened or (before == "down" and state in UP):
            self._opened = self.receiver.opened
            self.node.restart(now_us)  # claims may have been missed
        elif before == "bus-off" and state in UP:
            self.node.repeat_claim(now_us)  # who has taken the address meanwhile contests it
        self._bus_state = state
        frames = self.estimation.restamp(drained.frames)
        if len(frames):
            self.rates.frames += len(frames)
            self._frames_us = now_us
            self.node.observe(frames, now_us)
            self.outputs.add_frames(frames, now_s)

        def publish(estimates: Estimates, newest: Estimate) -> None:
            self.node.set_estimate(newest, now_us)
            self.outputs.add_estimates(estimates, now_s)

        self.estimation.update(frames, drained.reached_us, now_us, publish)
        self.node.send_due(now_us)
        self.reporter.stream(self._quiet_s(now_us), is_current=self.estimation.is_current(now_us))
        self.notifier.ping_watchdog(now_s)

    def _work_once_a_second(self, now_us: int, now_s: float) -> None:
        self.rates.end_period(now_s)
        self.sender_rates.update(self.pipeline.decoder.counters, now_s)
        self.outputs.flush_due(now_s)
        self.estimation.notes.update(now_s)
        self.reporter.report(self.view(now_us), self.outputs, now_s)
        if now_s >= self._save_at_s:
            if self._save_at_s:
                self.estimation.mass_store.save()
            self._save_at_s = now_s + self.config.service.save_every_s
        if self._counters_requested:
            self._counters_requested = False
            self.reporter.log_counters(self.view(now_us))
        if self._reload_requested and not self.reloads.under_way:  # a signal meanwhile waits for its turn
            self._reload_requested = False
            self.reloads.begin(self.config, self.pipeline, self.estimation.new_pipeline, now_s)

    # -- reload and signals -------------------------------------------------------------------------

    def _finish_reload(self, now_s: float) -> None:
        """Put a changed config into force once it is read; a broken one changes nothing."""
        prepared = self.reloads.finished(now_s)
        if prepared is None:
            return
        try:
            self._put_into_force(prepared, now_s)
        except Exception as error:  # whatever is wrong with the new config, the old one stays in force
            self.reloads.refuse(error)
        else:
            self.reloads.accept(self.config_name)

    def _put_into_force(self, prepared: Prepared, now_s: float) -> None:
        if prepared.joins_anew:  # what has arrived is of the old bus
            self._estimate_and_send(round(now_s * 1e6), now_s)
        new = replacement(prepared, self.pipeline, self.reporter.endpoints, self.node)
        self.config = new.config
        self.estimation.reconfigure(new.config, new.pipeline)
        if new.joined is not None:
            receiver, self.node = new.joined
            if receiver is not None:
                self.receiver.close()
                self.receiver = receiver
            self.estimation.odometer = self.node.monitor.odometer
            self._opened = self.receiver.opened
        self.outputs.close()
        self.outputs = Outputs(self.config, self.background)
        self._log_notes()

    def _log_notes(self) -> None:
        """Log what is odd about the config, as `canest check` has it, such as a unit that nobody states."""
        if notes := config_warnings(self.config):
            self.journal.warning("config-notes", notes="; ".join(notes))

    def _install_signals(self) -> None:
        def on_signal(number: int, frame: FrameType | None) -> None:
            if number == signal.SIGHUP:
                self.request_reload()
            elif number == signal.SIGUSR1:
                self.request_counters()
            else:
                self.stop()

        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1):
            signal.signal(number, on_signal)
