"""The residual of one or many drives as a regression problem: one row per window, whitened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from canest.core.errors import LogError
from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import GRAVITY_MPS2
from canest.diagnosis.data.drive import Drive, Run
from canest.diagnosis.data.drive_part import DrivePart, torque_step_N
from canest.diagnosis.data.least_squares import Matrix, held_out
from canest.diagnosis.data.reference import Reference
from canest.diagnosis.data.whitening import GradeFilter
from canest.vehicle.effects import Effect

MIN_WINDOWS = 8


class TooLittleDrivingError(LogError):
    """The logs that can be read hardly ever had open gates.

    failed: why others cannot be read; notes: log -> what a user should know of it.
    """

    failed: Sequence[str] = ()
    notes: Mapping[str, Sequence[str]] = MappingProxyType({})


class Problem:
    """Rows of all drives: residuals, regressors, chunks; the same whitening for every column."""

    def __init__(self, drives: Sequence[tuple[Drive, Reference, Run]], failed: Sequence[str] = ()) -> None:
        parts = [DrivePart(d, run, ref) for d, ref, run in drives]
        self.parts = [p for p in parts if p.windows.count >= MIN_WINDOWS]
        #: logs that cannot be used at all, and why
        self.failed = list(failed)
        #: log -> what a user should know of it, where there is anything
        self.notes = {str(d.path): found for d, ref, _ in drives if (found := [*d.notes, *ref.notes])}
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
        self._cached = lru_cache(maxsize=100)(self._residual_N)
        offset, chunks = 0, []
        for part in self.parts:
            chunks.append(part.windows.chunk + offset)
            offset += int(part.windows.chunk.max()) + 2
        self.chunk: IntColumn = np.unique(np.concatenate(chunks), return_inverse=True)[1]
        self.drive: IntColumn = np.repeat(np.arange(len(self.parts)), [p.windows.count for p in self.parts])
        self._filters = [GradeFilter(p) for p in self.parts]
        self.mass_known = all(p.reference.mass_kg is not None for p in self.parts)
        self.nuisance_N = self._nuisance()
        self.nuisance = self.whiten(self.nuisance_N)
        self._reference_errors = {n: self.whiten(column) for n, column in self.reference_errors_N().items()}
        weights = [p.mass_kg.mean() * GRAVITY_MPS2 for p in self.parts]
        self.weight_N = float(np.mean(weights))
        #: one step of the reported torque, as force at the wheels
        self.torque_step_N = float(np.mean([torque_step_N(p) for p in self.parts]))
        #: standard deviation of one window in N, where the whitening has settled
        self.unit_N = float(np.median(np.concatenate([f.std_N for f in self._filters])))

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
        return self._cached(tuple(effects))

    def _residual_N(self, effects: tuple[Effect, ...]) -> FloatColumn:
        residual = np.concatenate([p.residual_N(effects) for p in self.parts])
        residual.flags.writeable = False
        return residual

    def whiten(self, column_N: Matrix) -> Matrix:
        """Return innovations in units of their own standard deviation: an unknown grade is filtered out.

        column_N: one column (n,) or several (n, k), in N.
        """
        bounds = np.cumsum([0, *(p.windows.count for p in self.parts)])
        pieces = [
            f.innovations(column_N[a:b]) for f, (a, b) in zip(self._filters, pairwise(bounds), strict=True)
        ]
        return np.concatenate(pieces)

    def beside_nuisance(self, columns: Sequence[FloatColumn]) -> Matrix:
        """Return whitened regressors (n,) with what is always free behind them (n, columns)."""
        return np.column_stack([*columns, self.nuisance])

    def held_out(self, residual: FloatColumn, columns: Sequence[FloatColumn]) -> FloatColumn:
        """Return what is left of a whitened residual on windows that were not used to fit it (n,).

        Errors of the reference may take their part, each at the price of its spread. A chunk of what is left
        without them counts as one observation.
        """
        matrix = self.beside_nuisance(columns)
        left = held_out(residual, matrix, self.chunk)
        errors = list(self.reference_errors().values())
        if not errors:
            return left
        prior = np.eye(len(errors), len(errors) + matrix.shape[1]) * np.sqrt(left @ left / self.chunks)
        return held_out(residual, np.column_stack([*errors, matrix]), self.chunk, prior)

    def reference_errors(self) -> dict[str, FloatColumn]:
        """Return what steady errors of the reference do, whitened, per standard deviation (n,) each."""
        return self._reference_errors

    def reference_errors_N(self) -> dict[str, FloatColumn]:
        """Return what steady errors of the reference do, in N per standard deviation (n,) each.

        The accelerometer's bias and the body's pitch are known as well as the drive shows them: what is left
        of them looks like a steady force, and like inertia.
        """
        found = {}
        for i, part in enumerate(self.parts):
            here, reference = self.drive == i, part.reference
            accel = part.windows.mean(part.run.samples.accel_mps2)
            for name, column in (
                ("bias", reference.bias_std_mps2 * part.mass_w),
                ("pitch", reference.pitch_std * GRAVITY_MPS2 * part.mass_w * accel),
            ):
                if np.any(column):
                    whole = np.zeros(self.rows)
                    whole[here] = column
                    found[f"{name} of drive {i}"] = whole
        return found

    def grade_error_N(self) -> FloatColumn:
        """Return the standard deviation, N, that the error of the grade gives the mean of each block (k,)."""
        found = np.zeros(self.chunks)
        for i, part in enumerate(self.parts):
            std_N = part.reference.sin_beta_std * GRAVITY_MPS2 * float(part.mass_w.mean())
            chunk = self.chunk[self.drive == i]
            metres = np.cumsum(part.speed_mps)  # a window is a second
            for k in np.unique(chunk) if std_N else ():
                along = metres[chunk == k]
                shared = np.exp(-np.abs(along[:, None] - along) / part.reference.correlation_m)
                found[k] = std_N * np.sqrt(shared.mean())
        return found

    def _nuisance(self) -> Matrix:
        """Return what is always free per drive, in N per unit (n, columns).

        An unknown mass; and the accelerometer's bias where no altitude gives it. (Its pitch coupling is
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
