"""The learned mass between two runs of the daemon: restored at the start, saved while it runs."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from canest.config.schema import Config
from canest.config.state_directory import state_dir
from canest.core.samples import Status
from canest.live import state
from canest.pipeline.pipeline import Pipeline
from canest.system.clock import elapsed_s
from canest.system.files import Background
from canest.system.journal import Journal


def place(name: str, variable: str, environment: Mapping[str, str] = os.environ) -> Path:
    """Return a path of the config: a relative one lies in systemd's ``variable``, if set."""
    folder = environment.get(variable, "").split(":")[0]
    return Path(folder) / Path(name).expanduser()


def file_name(config: Config) -> str:
    """Return the name of the state file: one per bus, since a daemon may be moved to another vehicle."""
    return f"learned-{config.bus.file_name}.json"


class MassStore:
    """Keeps the last valid mass and writes it to the state file; a disk that fails does not end the daemon.

    learned: the last valid mass, None where there was none."""

    def __init__(
        self,
        config: Config,
        background: Background,
        journal: Journal,
        clock_s: Callable[[], float] = time.time,
        steady_s: Callable[[], float] = elapsed_s,
    ) -> None:
        self._config, self._background, self._journal = config, background, journal
        self._clock_s, self._steady_s = clock_s, steady_s
        self._learned_s: float | None = None  # by the steady clock; None: before this start
        self.path = state_dir(config) / file_name(config)
        self.learned: state.Learned | None = None
        self._fingerprint = state.fingerprint(config)
        self._key = state.vehicle_key(config)

    def restore(self, pipeline: Pipeline) -> None:
        """Start a pipeline from the state file of this vehicle, if there is a sound one."""
        if self._config.service.learn == "off":
            return
        now_s = self._clock_s()
        restored = state.load(self.path, self._config, now_s)
        if restored.message:
            self._journal.warning("state-not-used", why=restored.message)
        self.learned = restored.learned
        self.initialise(pipeline)

    def initialise(self, pipeline: Pipeline) -> None:
        """Start a pipeline from the learned mass, and the time in which nobody saw the load.

        Not where the config, which may be another by now, wants no learned mass or allows none like it.
        """
        learned = self.learned
        if learned is None or self._config.service.learn == "off" or not state.fits(learned, self._config):
            return
        now_s = self._clock_s()
        std_kg = state.widened_std_kg(learned, self._config)
        pipeline.restore(learned.mass_kg, std_kg, state.unseen_s(learned, now_s))
        self._journal.notice(
            "mass-restored",
            mass_kg=round(learned.mass_kg),
            std_kg=round(std_kg),
            saved_std_kg=round(learned.mass_std_kg),
            age_s=round(now_s - learned.saved_s),
        )

    def transferred(self, config: Config, pipeline: Pipeline | None) -> MassStore:
        """Return the store of a changed config; it keeps the learned mass if the vehicle is the same.

        pipeline: the new one, started from the mass; None where the old one goes on.
        """
        self.save()
        new = MassStore(config, self._background, self._journal, self._clock_s, self._steady_s)
        if self.learned is not None and new._key == self._key:
            new.learned, new._learned_s = self.learned, self._learned_s
            if pipeline is not None:
                new.initialise(pipeline)
        elif pipeline is not None:
            new.restore(pipeline)
        return new

    def update(
        self, mass_kg: float, mass_std_kg: float, status: int, standing: bool, distance_km: float | None
    ) -> None:
        """Keep the newest estimate if it is valid; ``distance_km``: confirmed odometer."""
        if (
            status == Status.VALID
            and math.isfinite(mass_kg)
            and math.isfinite(mass_std_kg)
            and mass_std_kg > 0
        ):
            self._learned_s = self._steady_s()
            self.learned = state.Learned(
                self._key,
                self._fingerprint,
                float(mass_kg),
                float(mass_std_kg),
                self._clock_s(),
                standing,
                distance_km,
            )

    def save(self) -> None:
        """Queue the state file for writing, with the age that the mass has whatever the wall clock did."""
        learned = self.learned
        if self._config.service.learn == "on+save" and learned is not None:
            if self._learned_s is not None:
                saved_s = self._clock_s() - (self._steady_s() - self._learned_s)
                learned = replace(learned, saved_s=max(saved_s, 0.0))
            self._background.submit("state", lambda: state.save(self.path, learned), newest_only=True)
