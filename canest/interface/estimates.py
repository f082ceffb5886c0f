"""Mass and grade as columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from canest.core import estimates as inner
from canest.core.errors import UsageError
from canest.core.frames import FloatColumn
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS

if TYPE_CHECKING:
    import pandas as pd

    from canest.config import Config


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Mass and grade, one row per 50 Hz sample: the columns of est.csv, each (n,).

    Attributes:
        t_s: seconds of the log's clock, float64.
        mass_kg: float64, NaN where there is no number yet.
        mass_std_kg: its standard deviation, float64.
        grade: slope as a ratio, tan(beta), uphill positive, float64.
        grade_std: its standard deviation, float64.
        status: uint8, codes of `Status`.
        gate: uint8, codes of `Gate`: why the sample was not learned from, 0 where it was.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> result = canest.replay(drive, drive.config)
        >>> learned = result.mass_kg[result.gate == canest.Gate.OPEN]
        >>> bool((result.status == canest.Status.VALID).any())
        True
    """

    t_s: FloatColumn
    mass_kg: FloatColumn
    mass_std_kg: FloatColumn
    grade: FloatColumn
    grade_std: FloatColumn
    status: NDArray[np.uint8]
    gate: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t_s)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the seven columns by their names in est.csv, the last two as codes: {name: (n,)}."""
        return {name: getattr(self, name) for name in Estimates.__slots__}

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas table (n rows) as est.parquet reads: status and gate as categories of text.

        Errors: UsageError where pandas is not installed.
        """
        pd = pandas()
        columns: dict[str, Any] = self.columns()
        for name, labels in (("status", STATUS_LABELS), ("gate", LABELS)):
            known = [labels.get(code, "") for code in range(max(labels) + 1)]
            columns[name] = pd.Categorical.from_codes(columns[name].astype(np.int8), known)
        return pd.DataFrame(columns)


@dataclass(frozen=True, slots=True, eq=False)
class Replay(Estimates):
    """Estimates of a log or table, with what was found beside them.

    Attributes:
        summary: what `canest replay --json` writes: counts, gates, the last mass, errors where the truth
            was given, and notes.
        config: under which it was estimated; of a table named by roles, the one made for it.

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> result = canest.replay(drive, drive.config, truth=drive.truth)
        >>> result.summary["errors"]["mass_rms_pct"] < 5.0
        True
    """

    summary: Mapping[str, Any] = field(repr=False)
    config: Config = field(repr=False)


def columns_of(estimates: inner.Estimates) -> dict[str, Any]:
    """Return the arguments of `Estimates`."""
    e = estimates
    return {
        "t_s": e.t_us / 1e6,
        "mass_kg": e.mass_kg,
        "mass_std_kg": e.mass_std_kg,
        "grade": e.grade,
        "grade_std": e.grade_std,
        "status": e.status,
        "gate": e.gate,
    }


def estimates_of(estimates: inner.Estimates) -> Estimates:
    """Return the pipeline's estimates with their time in seconds."""
    return Estimates(**columns_of(estimates))


def pandas() -> Any:
    """Return the pandas package. Errors: UsageError where it is not installed."""
    try:
        import pandas as pd
    except ImportError:
        raise UsageError("to_pandas needs pandas", expected="pip install pandas") from None
    return pd
