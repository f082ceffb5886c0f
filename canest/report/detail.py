"""All samples of a drive for a page: packed tightly enough that hours of 50 Hz stay a few megabytes.

A chunk holds some thousand samples. Each column of it is whole numbers of its resolution. The page gets
their differences, zigzag-coded (0, -1, 1, -2 ... become 0, 1, 2, 3 ...): the lowest bytes of all first, then
the next higher ones, and so on, deflated. ``assets/detail.js`` undoes that, one chunk when it is wanted.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from canest.core.frames import FloatColumn, IntColumn
from canest.core.samples import STEP_S

#: column -> its resolution: finer than est.csv is read, coarser than noise
RESOLUTIONS: dict[str, float] = {
    "mass_kg": 0.1, "mass_std_kg": 0.1, "grade": 1e-5, "grade_std": 1e-5, "speed_mps": 1e-3, "torque_Nm": 1.0,
    "gear": 1.0, "traction_N": 1.0, "force_N": 1.0, "residual_N": 1.0, "gate": 1.0, "status": 1.0,
    "distance_m": 0.1,
}  # fmt: skip
CHUNK = 4096
#: (bytes from which on, every so many ticks is kept): 50 Hz, then 10 Hz, then 1 Hz
STAGES = ((0, 1), (6_000_000, 5), (9_000_000, 50))
#: stands for "no number"; nothing of a vehicle comes near it
NO_NUMBER = -(2**31)


class Detail:
    """Packs samples while they stream by; memory is that of the packed chunks."""

    def __init__(self) -> None:
        self.chunks: list[dict[str, Any]] = []
        self.size = 0  #: bytes of all chunks
        self._held: list[dict[str, FloatColumn]] = []
        self._waiting = 0

    @property
    def every(self) -> int:
        """Return of how many ticks one is kept now."""
        return [every for start, every in STAGES if self.size >= start][-1]

    def push(self, ticks: IntColumn, columns: Mapping[str, FloatColumn]) -> None:
        """Take samples. ticks: (n,) of 20 ms since the start. columns: those of `RESOLUTIONS`, (n,) each."""
        keep = ticks % self.every == 0
        held = {name: np.asarray(columns[name], np.float64)[keep] for name in RESOLUTIONS}
        self._held.append({"tick": ticks[keep].astype(np.float64), **held})
        self._waiting += int(np.count_nonzero(keep))
        if self._waiting >= CHUNK:
            self._pack(CHUNK)

    def to_json(self) -> dict[str, Any]:
        """Return what the page unpacks."""
        if self._waiting:
            self._pack(1)
        columns = [["tick", 1.0], *([name, step] for name, step in RESOLUTIONS.items())]
        return {"step_s": STEP_S, "columns": columns, "chunks": self.chunks}

    def _pack(self, least: int) -> None:
        """Pack what waits, in chunks; fewer than ``least`` samples go on waiting."""
        columns = {name: np.concatenate([held[name] for held in self._held]) for name in self._held[0]}
        start = 0
        while self._waiting - start >= least:
            part = {name: column[start : start + CHUNK] for name, column in columns.items()}
            whole = {name: part[name] / step for name, step in RESOLUTIONS.items()}
            self._add({"tick": part["tick"], **whole})
            start += len(part["tick"])
            if start == self._waiting:
                break
        self._held = [{name: column[start:] for name, column in columns.items()}]
        self._waiting -= start

    def _add(self, part: Mapping[str, FloatColumn]) -> None:
        packed, ticks = packed_columns(part.values()), part["tick"]
        self.size += len(packed)
        self.chunks.append({
            "first": float(ticks.min()) * STEP_S, "last": float(ticks.max()) * STEP_S, "count": len(ticks),
            "data": base64.b64encode(packed).decode("ascii"),
        })  # fmt: skip


def packed_columns(columns: Iterable[FloatColumn]) -> bytes:
    """Return columns (n,) of whole numbers, each rounded, as deflated bytes."""
    planes = []
    for column in columns:
        known = np.isfinite(column) & (np.abs(column) < -NO_NUMBER)
        whole = np.where(known, np.round(np.where(known, column, 0.0)), NO_NUMBER).astype(np.int64)
        # differences wrap around at 32 bits, as the page's sums do
        steps = np.diff(whole, prepend=0).astype(np.int32)
        zigzag = ((steps << 1) ^ (steps >> 31)).astype("<u4")
        planes.append(zigzag.view(np.uint8).reshape(-1, 4).T.tobytes())
    return zlib.compress(b"".join(planes), 6)
