"""The residual of one or many drives as a regression problem: one row per window, whitened."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from canest.diagnose.drive import Drive, Run
from canest.diagnose.reference import Reference
from canest.diagnose.windows import Windows, windows_of
from canest.errors import LogError
from canest.frames import FloatColumn, IntColumn
from canest.vehicle.effects import Effect
from canest.vehicle.samples import GRAVITY_MPS2

Matrix = NDArray[np.float64]
#: what is left of speed quantisation and oscillation in a one-second mean, as specific force (m/s2)
WINDOW_NOISE_MPS2 = 0.004
MIN_WINDOWS = 8


class _Part:
    """One drive's share of the problem."""

    def __init__(self, drive: Drive, run: Run, reference: Reference) -> None:
        self.drive, self.run, self.reference = drive, run, reference
        m = run.samples
        usable = np.isfinite(m.force_N) & np.isfinite(m.speed_mps)
        if reference.mass_kg is not None:
            usable &= np.isfinite(reference.mass_kg)
        self.windows: Windows = windows_of(run.open, run.t_s, usable)
        self.speed_mps = self.windows.mean(m.speed_mps)
        self.cos_beta = np.sqrt(1.0 - np.minimum(reference.sin_beta**2, 0.5))
        self.specific = self._specific(run)
        self.mass_kg = self._mass()
        self.mass_w = self.windows.mean(self.mass_kg)

    def _specific(self, run: Run) -> FloatColumn:
        m = run.samples
        return m.accel_mps2 + GRAVITY_MPS2 * (self.reference.sin_beta + m.mu * self.cos_beta)

    def _mass(self) -> FloatColumn:
        """Return the known mass, else the least-squares start value (it stays free in every fit)."""
        if self.reference.mass_kg is not None:
            return self.reference.mass_kg
        s, f = self.windows.mean(self.specific), self.windows.mean(self.run.samples.force_N)
        s, f = s - s.mean(), f - f.mean()
        v = self.drive.config.vehicle
        raw = float(s @ f / (s @ s)) if s @ s > 0 else v.mass_min_kg
        return np.full(len(self.specific), np.clip(raw, v.mass_min_kg, v.mass_max_kg))

    def residual_N(self, run: Run) -> FloatColumn:
        """Return the force that the model has and the reference does not need, per window."""
        return self.windows.mean(run.samples.force_N - self.mass_kg * self._specific(run))


class Problem:
    """Rows of all drives: residuals, regressors, chunks; the same whitening for every column."""

    def __init__(self, drives: Sequence[tuple[Drive, Reference, Run]]) -> None:
        parts = [_Part(d, run, ref) for d, ref, run in drives]
        self.parts = [p for p in parts if p.windows.count >= MIN_WINDOWS]
        if not self.parts:
            raise LogError(
                "too little driving with open gates to diagnose",
                found=f"{sum(p.windows.count for p in parts)} seconds",
                expected=f"at least {MIN_WINDOWS} in a row; see `canest check`",
            )
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

    @property
    def rows(self) -> int:
        """How many windows there are."""
        return len(self.chunk)

    def residual_N(self, effects: Sequence[Effect]) -> FloatColumn:
        """Return the residual of the model with these effects, in N, not whitened (n,)."""
        return np.concatenate([p.residual_N(p.drive.run(effects)) for p in self.parts])

    def whiten(self, column_N: FloatColumn) -> FloatColumn:
        """Return innovations in units of their own standard deviation: an unknown grade is filtered out."""
        out, start = [], 0
        for part in self.parts:
            n = part.windows.count
            out.append(_innovations(column_N[start : start + n], part))
            start += n
        return np.concatenate(out)

    def _nuisance(self) -> Matrix:
        """Return what is always free, in N per kg: an unknown mass of each drive (n, drives)."""
        columns = []
        for i, part in enumerate(self.parts):
            if part.reference.mass_kg is None:
                column = np.zeros(self.rows)
                column[self.drive == i] = -part.windows.mean(part.specific)
                columns.append(column)
        return np.column_stack(columns) if columns else np.zeros((self.rows, 0))


def _innovations(x_N: FloatColumn, part: _Part) -> FloatColumn:
    """Run the scalar grade filter over a column: state = grade error force, decaying over distance."""
    noise = (WINDOW_NOISE_MPS2 * part.mass_w) ** 2
    spread = (part.reference.sin_beta_std * GRAVITY_MPS2 * part.mass_w) ** 2
    if part.reference.sin_beta_std == 0.0:
        return np.asarray(x_N / np.sqrt(noise))
    out = np.empty(len(x_N))
    state, variance, before = 0.0, float(spread[0]), float(part.windows.t_s[0])
    for k in range(len(x_N)):
        now = float(part.windows.t_s[k])
        keep = np.exp(-(now - before) * part.speed_mps[k] / part.reference.correlation_m)
        before = now
        state, variance = keep * state, keep * keep * variance + (1 - keep * keep) * spread[k]
        s = variance + noise[k]
        innovation = x_N[k] - state
        out[k] = innovation / np.sqrt(s)
        gain = variance / s
        state, variance = state + gain * innovation, (1 - gain) * variance
    return out
