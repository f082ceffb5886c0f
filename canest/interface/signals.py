"""Decoded signals as columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canest.core.frames import FloatColumn
from canest.interface.estimates import pandas

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """Every signal that a config maps, held at 50 Hz.

    Attributes:
        t_s: seconds of the log's clock, float64 (n,), multiples of 0.02 s; where the bus was silent for
            longer than the config's sampling.hold_s, rows are missing.
        values: role -> float64 (n,), in the role's unit (docs/config.md); NaN where it is too old, was never
            sent, or is "not available".

    Example:
        >>> import canest
        >>> drive = canest.demo_drive()
        >>> signals = canest.read_signals(drive, drive.config)
        >>> bool(signals.values["vehicle_speed"].max() < 40)
        True
    """

    t_s: FloatColumn
    values: Mapping[str, FloatColumn]

    def __len__(self) -> int:
        return len(self.t_s)

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas table, t_s and a column per role, as `canest.estimate` takes it.

        Errors: UsageError where pandas is not installed.
        """
        return pandas().DataFrame({"t_s": self.t_s, **self.values})
