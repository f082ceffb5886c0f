"""One drive's share of the regression problem: its windows, its mass and its residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from canest.core.frames import FloatColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ
from canest.diagnosis.data.drive import Drive, Run
from canest.diagnosis.data.reference import Reference, filled
from canest.diagnosis.data.residual_windows import Windows, windows_of
from canest.pipeline.signal_map import resolution_of
from canest.vehicle.effects import Effect
from canest.vehicle.effects.load import added_kg


class DrivePart:
    """A drive with its reference, cut into windows of one second."""

    def __init__(self, drive: Drive, run: Run, reference: Reference) -> None:
        self.drive, self.run, self.reference = drive, run, reference
        m = run.samples
        usable = np.isfinite(m.force_N) & np.isfinite(m.speed_mps)
        if reference.mass_kg is not None:
            usable &= np.isfinite(reference.mass_kg)
        if reference.grade is not None:
            usable &= np.isfinite(reference.grade)
        self.windows: Windows = windows_of(run.open, run.t_s, usable)
        self.speed_mps = self.windows.mean(m.speed_mps)
        self.cos_beta = np.sqrt(1.0 - np.minimum(reference.sin_beta**2, 0.5))
        self.specific = self._specific(run)
        self.mass_kg = self._mass()
        self.mass_w = self.windows.mean(self.mass_kg)
        self._latest: tuple[tuple[Effect, ...], Run] | None = None

    def _specific(self, run: Run) -> FloatColumn:
        m = run.samples
        accel_mps2, mu = self._at_once(run, m.accel_mps2), self._at_once(run, m.mu)
        return accel_mps2 + GRAVITY_MPS2 * (self.reference.sin_beta + mu * self.cos_beta)

    def _at_once(self, run: Run, column: FloatColumn) -> FloatColumn:
        """Return a run's column (n,) when it shows what the first run shows: the reference is of that.

        A run that waits longer for what is reported late shows the same moment at a later tick.
        """
        later = (run.behind_s - self.run.behind_s) * RATE_HZ
        if not later:
            return column
        ticks = np.arange(len(column), dtype=np.float64)
        moved = np.interp(ticks + later, ticks, column)
        return np.where(np.isfinite(moved), moved, column)

    def _mass(self) -> FloatColumn:
        """Return the known mass, else the least-squares start value (it stays free in every fit)."""
        if self.reference.mass_kg is not None:
            return filled(self.reference.mass_kg)
        v = self.drive.config.vehicle
        if not self.windows.count:
            return np.full(len(self.specific), v.mass_min_kg)
        s, f = self.windows.mean(self.specific), self.windows.mean(self.run.samples.force_N)
        s, f = s - s.mean(), f - f.mean()
        raw = float(s @ f / (s @ s)) if s @ s > 0 else v.mass_min_kg
        return np.full(len(self.specific), np.clip(raw, v.mass_min_kg, v.mass_max_kg))

    def residual_N(self, effects: Sequence[Effect]) -> FloatColumn:
        """Return the force of the model with these effects less what the reference needs, per window."""
        # a load is no part of the model: what differs in loads alone has one run
        model = tuple(e for e in effects if e.stage != "load")
        if self._latest is None or self._latest[0] != model:
            self._latest = model, self.drive.run(model)
        run = self._latest[1]
        mass_kg = self.mass_kg + added_kg(effects, self.run.samples.t_us)
        return self.windows.mean(self._at_once(run, run.samples.force_N) - mass_kg * self._specific(run))


def torque_step_N(part: DrivePart) -> float:
    """Return one step of the reported torque as force at the wheels, N: the mean of a drive."""
    lever = part.windows.mean(np.nan_to_num(part.run.samples.force_per_torque_1pm))
    source = part.drive.config.signals.get("engine_torque")
    if source is not None and source.column is not None:
        # nobody declares a table's resolution, but its values have it
        values = np.unique(part.run.torque_Nm[np.isfinite(part.run.torque_Nm)])
        step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    else:
        step = resolution_of(part.drive.config)["torque"]
    return step * float(lever.mean())
