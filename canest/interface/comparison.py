"""What came out of every estimator on one log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from canest.core.frames import FloatColumn
from canest.interface.estimates import Estimates, pandas

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Estimators side by side on the same samples.

    Attributes:
        table: what `canest compare --json` writes; its "estimators" are {name: {mass_end_pct, mass_rms_pct,
            mass_max_pct, grade_rms_deg, to_5pct_s, ns_per_sample, note}}, None where a number does not apply.
        estimates: name -> its `Estimates`, all of the same n samples.
        true_mass_kg, true_grade: the truth at those samples, float64 (n,), NaN where unknown.
        speed_mps: unfiltered speed, float64 (n,), NaN where unknown.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> both = canest.compare(drive, drive.config, truth=drive.truth, estimators=["canest", "rls"])
        >>> sorted(both.estimates)
        ['canest', 'rls']
    """

    table: Mapping[str, Any]
    estimates: Mapping[str, Estimates]
    true_mass_kg: FloatColumn
    true_grade: FloatColumn
    speed_mps: FloatColumn

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas table: a row per estimator, a column per number. Errors: UsageError."""
        table = pandas().DataFrame.from_dict(self.table["estimators"], orient="index")
        return table.astype({name: float for name in table.columns if name != "note"})
