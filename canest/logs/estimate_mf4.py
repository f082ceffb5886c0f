"""Estimates as an MF4 file (asammdf, extra ``formats``), beside the signals of a measurement."""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core.errors import OutputError
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS
from canest.logs.blf_writer import FIRST_DATE_S
from canest.logs.estimate_file import Columns, Decimals, EstimateWriter
from canest.logs.estimate_message import unit
from canest.system.installation import how_to_add

if TYPE_CHECKING:
    from canest.core.estimates import Estimates


#: where a clock of the day is zero
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: a file that counts from 1970 has 64 bits for nanoseconds
_CALENDAR_END_US = 2**63 // 1000


class Mf4EstimateWriter(EstimateWriter):
    """The columns of est.csv as one channel group; status and gate are codes with their names.

    The file begins with the first estimate, and its master channel counts seconds from there. Where the log's
    clock is no calendar it counts that clock's seconds, from 1970. asammdf writes a file at once, so the
    columns stay in memory until the end: 10 MB per hour of driving.
    """

    def __init__(self, path: Path, more: Decimals | None = None) -> None:
        try:
            import asammdf
        except ImportError:
            raise OutputError(
                "cannot write MF4", where=str(path), expected=f"the asammdf package: {how_to_add('formats')}"
            ) from None
        super().__init__(path)
        self._asammdf: Any = asammdf
        self._more = tuple(more or {})
        self._held: list[tuple[Estimates, Columns]] = []

    def write(self, estimates: Estimates, more: Columns | None = None) -> None:
        """Keep the next rows."""
        self._held.append((estimates, more or {}))

    def _finish(self) -> None:
        content = io.BytesIO()
        with self._asammdf.MDF(version="4.10") as mdf:
            start_us = self._start_us()
            mdf.start_time = EPOCH + timedelta(microseconds=start_us)
            if self._held:
                mdf.append(self._signals(start_us), comment="canest")
            mdf.save(content, overwrite=True, compression=2)
        self._out.write(content.getvalue())

    def _start_us(self) -> int:
        """Return when the file begins, us since 1970; 0 where the log's clock is no calendar."""
        start_us = min((int(estimates.t_us.min()) for estimates, _ in self._held), default=0)
        return start_us if FIRST_DATE_S * 10**6 <= start_us < _CALENDAR_END_US else 0

    def _signals(self, start_us: int) -> list[Any]:
        def column(name: str) -> Any:
            return np.concatenate([getattr(estimates, name) for estimates, _ in self._held])

        t_s = (column("t_us") - start_us) / 1e6
        columns = {name: column(name) for name in ("mass_kg", "mass_std_kg", "grade", "grade_std")}
        columns |= {name: np.concatenate([more[name] for _, more in self._held]) for name in self._more}
        codes = {"status": STATUS_LABELS, "gate": LABELS}
        signals = [
            self._asammdf.Signal(values, t_s, name=name, unit=unit(name)) for name, values in columns.items()
        ]
        for name, labels in codes.items():
            names = {f"val_{i}": code for i, code in enumerate(labels)}
            texts = {f"text_{i}": label for i, label in enumerate(labels.values())}
            signals.append(self._asammdf.Signal(column(name), t_s, name=name, conversion={**names, **texts}))
        return signals
