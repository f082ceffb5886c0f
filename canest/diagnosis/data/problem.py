"""The residual of one or many drives as a regression problem: one row per window, whitened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2, RATE_HZ
from canest.diagnosis.data.drive import Drive, Run
from canest.diagnosis.data.least_squares import Matrix, held_out
from canest.diagnosis.data.reference import Reference, filled
from canest.diagnosis.data.residual_windows import Windows, windows_of
from canest.pipeline.signal_map import resolution_of
from canest.vehicle.effects import Effect
from canest.vehicle.effects.load import added_kg

#: what is left of speed quantisation and oscillation in a one-second mean, as specific force (m/s2)
WINDOW_NOISE_MPS2 = 0.004
MIN_WINDOWS = 8


class TooLittleDrivingError(LogError):
    """The logs that can be read hardly ever had open gates.

    failed: why others cannot be read; notes: log -> what a user should know of it.
    """

    failed: Sequence[str] = ()
    notes: Mapping[str, Sequence[str]] = MappingProxyType({})


class _Part:
    """One drive's share of the problem."""

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


class Problem:
    """Rows of all drives: residuals, regressors, chunks; the same whitening for every column."""

    def __init__(self, drives: Sequence[tuple[Drive, Reference, Run]], failed: Sequence[str] = ()) -> None:
        parts = [_Part(d, run, ref) for d, ref, run in drives]
        self.parts = [p for p in parts if p.windows.count >= MIN_WINDOWS]
        #: logs that cannot be used at all, and why
        self.failed = list(failed)
        #: log -> what a user should know of it, where there is anything
        self.notes = {str(d.path): d.notes for d, _, _ in drives if d.notes}
        #: logs that take no part, and why
        self.left_out = [
            f"{p.drive.path}: only {p.windows.count} s with open gates"
            for p in parts
            if p.windows.count < MIN_WINDOWS
        ]
        if not self.parts:
            error = TooLittleDrivingError(
                "too little driving with open gates to diagnose",
                found=f"{sum(p.windows.count for p in parts)} seconds",
                expected=f"at least {MIN_WINDOWS} in a row; see `canest check`",
            )
            error.failed, error.notes = self.failed, self.notes
            raise error
        # a fit asks for the same values again and again, and each costs a run of the model
        self._remembered = lru_cache(maxsize=100)(self._residual_N)
        offset, chunks = 0, []
        for part in self.parts:
            chunks.append(part.windows.chunk + offset)
            offset += int(part.windows.chunk.max()) + 2
        self.chunk: IntColumn = np.unique(np.concatenate(chunks), return_inverse=True)[1]
        self.drive: IntColumn = np.repeat(np.arange(len(self.parts)), [p.windows.count for p in self.parts])
        self.mass_known = all(p.reference.mass_kg is not None for p in self.parts)
        self.nuisance_N = self._nuisance()
        self.nuisance = np.column_stack(
            [self.whiten(c) for c in self.nuisance_N.T] or [np.zeros((self.rows, 0))]
        )
        weights = [p.mass_kg.mean() * GRAVITY_MPS2 for p in self.parts]
        self.weight_N = float(np.mean(weights))
        #: one step of the reported torque, as force at the wheels
        self.torque_step_N = float(np.mean([_torque_step_N(p) for p in self.parts]))
        #: standard deviation of one window in N, where the whitening has settled
        self.unit_N = float(np.median(np.concatenate([_innovations(None, p) for p in self.parts])))

    @property
    def chunks(self) -> int:
        """How many blocks of driving the windows make."""
        return int(self.chunk.max()) + 1

    @property
    def rows(self) -> int:
        """How many windows there are."""
        return len(self.chunk)

    def residual_N(self, effects: Sequence[Effect]) -> FloatColumn:
        """Return the residual of the model with these effects, in N, not whitened (n,)."""
        return self._remembered(tuple(effects))

    def _residual_N(self, effects: tuple[Effect, ...]) -> FloatColumn:
        residual = np.concatenate([p.residual_N(effects) for p in self.parts])
        residual.flags.writeable = False
        return residual

    def whiten(self, column_N: FloatColumn) -> FloatColumn:
        """Return innovations in units of their own standard deviation: an unknown grade is filtered out."""
        out, start = [], 0
        for part in self.parts:
            n = part.windows.count
            out.append(_innovations(column_N[start : start + n], part))
            start += n
        return np.concatenate(out)

    def beside_nuisance(self, columns: Sequence[FloatColumn]) -> Matrix:
        """Return whitened regressors (n,) with what is always free behind them (n, columns)."""
        return np.column_stack([*columns, self.nuisance])

    def held_out(self, residual: FloatColumn, columns: Sequence[FloatColumn]) -> FloatColumn:
        """Return what is left of a whitened residual on windows that were not used to fit it (n,)."""
        return held_out(residual, self.beside_nuisance(columns), self.chunk)

    def _nuisance(self) -> Matrix:
        """Return what is always free per drive, in N per unit (n, columns).

        An unknown mass; and the accelerometer's bias where no altitude tells it. (Its pitch coupling is
        left to the smoother: free here, it would take what inertia and rolling radius do.)
        """
        columns = []
        for i, part in enumerate(self.parts):
            here = self.drive == i
            kind = part.reference.kind
            free = []
            if part.reference.mass_kg is None:
                free.append(-part.windows.mean(part.specific))
            if kind == "accelerometer":
                free.append(part.mass_w)
            for column in free:
                whole = np.zeros(self.rows)
                whole[here] = column
                columns.append(whole)
        return np.column_stack(columns) if columns else np.zeros((self.rows, 0))


def _torque_step_N(part: _Part) -> float:
    lever = part.windows.mean(np.nan_to_num(part.run.samples.force_per_torque_1pm))
    source = part.drive.config.signals.get("engine_torque")
    if source is not None and source.column is not None:
        # nobody declares a table's resolution, but its values have it
        values = np.unique(part.run.torque_Nm[np.isfinite(part.run.torque_Nm)])
        step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    else:
        step = resolution_of(part.drive.config)["torque"]
    return step * float(lever.mean())


def _innovations(x_N: FloatColumn | None, part: _Part) -> FloatColumn:
    """Run the scalar grade filter over a column: state = grade error force, decaying over distance.

    Without a column: the standard deviations of the innovations, N.
    """
    noise = (WINDOW_NOISE_MPS2 * part.mass_w) ** 2
    spread = (part.reference.sin_beta_std * GRAVITY_MPS2 * part.mass_w) ** 2
    n = part.windows.count
    if part.reference.sin_beta_std == 0.0:
        return np.sqrt(noise) if x_N is None else np.asarray(x_N / np.sqrt(noise))
    out = np.empty(n)
    state, variance, before = 0.0, float(spread[0]), float(part.windows.t_s[0])
    for k in range(n):
        now = float(part.windows.t_s[k])
        keep = np.exp(-(now - before) * part.speed_mps[k] / part.reference.correlation_m)
        before = now
        state, variance = keep * state, keep * keep * variance + (1 - keep * keep) * spread[k]
        s = variance + noise[k]
        gain = variance / s
        if x_N is None:
            out[k] = np.sqrt(s)
        else:
            innovation = x_N[k] - state
            out[k] = innovation / np.sqrt(s)
            state += gain * innovation
        variance *= 1 - gain
    return out
