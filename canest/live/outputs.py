"""The files the daemon writes besides its state: recordings, the log of estimates, metrics."""

from __future__ import annotations

import os
from typing import Any

from canest.config.schema import Config
from canest.core.estimates import Estimates
from canest.core.frames import FrameBlock
from canest.live.mass_store import place
from canest.live.record import Ring, TextLog, candump_renderer, render_estimates
from canest.logs.estimate_writer import HEADER
from canest.system.files import Background, write_atomically
from canest.telemetry import metrics


class Outputs:
    """The files a config asks for, written by the background thread."""

    def __init__(self, config: Config, background: Background) -> None:
        service, channel = config.service, config.bus.channel
        self._service, self._background = service, background
        self._frames: list[TextLog[FrameBlock] | Ring] = []
        self._estimates: TextLog[Estimates] | None = None
        if service.record is not None:
            path = place(service.record, "STATE_DIRECTORY")
            self._frames.append(TextLog(path, candump_renderer(channel), background, kind="record"))
        folder = service.residual_dir
        if folder is None and "STATE_DIRECTORY" in os.environ:
            folder = "recorded"  # a service keeps what it received: `canest diagnose --recorded`
        if folder is not None:
            limit = int(service.residual_max_mb * 1e6)
            self._frames.append(Ring(place(folder, "STATE_DIRECTORY"), channel, limit, background))
        metrics_file = service.metrics_file
        if metrics_file is None and "RUNTIME_DIRECTORY" in os.environ:
            metrics_file = "canest.prom"  # for whoever runs a node_exporter
        self._metrics = None if metrics_file is None else place(metrics_file, "RUNTIME_DIRECTORY")
        if service.log_estimates is not None:
            path = place(service.log_estimates, "STATE_DIRECTORY")
            self._estimates = TextLog(path, render_estimates, background, kind="estimates", header=HEADER)

    def add_frames(self, frames: FrameBlock, now_s: float) -> None:
        """Record received frames; an empty block only writes what is held, when that is due."""
        for log in self._frames:
            log.add(frames, now_s)

    def add_estimates(self, estimates: Estimates, now_s: float) -> None:
        """Log estimates; an empty block as for `add_frames`."""
        if self._estimates is not None:
            self._estimates.add(estimates, now_s)

    def flush_due(self, now_s: float) -> None:
        """Write what is held, when that is due, although nothing new comes."""
        self.add_frames(FrameBlock.empty(), now_s)
        self.add_estimates(Estimates.concatenate([]), now_s)

    @property
    def wants_metrics(self) -> bool:
        """Return whether a metrics file or port is configured."""
        return self._metrics is not None or self._service.metrics_port is not None

    def write_metrics(self, snapshot: dict[str, Any]) -> None:
        """Queue the metrics file, if there is one."""
        path = self._metrics
        if path is None:
            return
        data = metrics.text(snapshot).encode()
        self._background.submit(
            "metrics", lambda: write_atomically(path, data, durable=False), newest_only=True
        )

    def close(self) -> None:
        """Queue the end of every file."""
        for log in self._frames:
            log.close()
        if self._estimates is not None:
            self._estimates.close()
