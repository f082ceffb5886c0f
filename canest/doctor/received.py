"""What a log or bus has carried: frames, rows, addresses, time, and the range of every role."""

from __future__ import annotations

import numpy as np

from canest.core.frames import ERROR, EXTENDED, FrameBlock
from canest.core.table_block import TableBlock
from canest.decode import j1939
from canest.doctor.stretches import Samples


class Received:
    """Streams blocks and their samples; memory does not grow with the log.

    frames, rows: of a bus or log, and of them rows of a table. error_frames, standard_frames: error frames,
    frames with 11-bit identifiers. standard_ids: those of the latter. addresses, pgns: of the 29-bit ones.
    columns: of a table. missing_cells: role -> samples without a value. ranges: role -> lowest, highest value
    and their count.
    """

    def __init__(self) -> None:
        self.frames = self.rows = self.error_frames = self.standard_frames = 0
        self.standard_ids: set[int] = set()
        self.addresses: set[int] = set()
        self.pgns: set[int] = set()
        self.columns: set[str] = set()
        self.missing_cells: dict[str, int] = {}
        self.ranges: dict[str, tuple[float, float, int]] = {}
        self._span_us: tuple[int, int] | None = None

    def push(self, block: FrameBlock | TableBlock) -> None:
        """Count the next block, which is not empty."""
        first, last = int(block.t_us.min()), int(block.t_us.max())
        known = self._span_us or (first, last)
        self._span_us = min(first, known[0]), max(last, known[1])
        self.frames += len(block)
        if isinstance(block, FrameBlock):
            self._push_frames(block)
        else:
            self.rows += len(block)
            self.columns |= {*block.columns, *block.texts}

    def _push_frames(self, block: FrameBlock) -> None:
        error = (block.can_id & np.uint32(ERROR)) != 0
        self.error_frames += int(np.count_nonzero(error))
        extended = (block.can_id & np.uint32(EXTENDED)) != 0
        self.standard_frames += int(np.count_nonzero(~extended))
        self.standard_ids.update((np.unique(block.can_id[~extended & ~error]) & np.uint32(0x7FF)).tolist())
        identifiers = np.unique(block.can_id[extended])
        self.addresses.update(np.unique(identifiers & np.uint32(0xFF)).tolist())
        groups = np.unique(identifiers >> np.uint32(8) << np.uint32(8))
        self.pgns.update(map(j1939.pgn_of, groups.tolist()))

    def note(self, samples: Samples) -> None:
        """Take the samples of the block."""
        for role, (_, values) in samples.items():
            valid = values[np.isfinite(values)]
            self.missing_cells[role] = self.missing_cells.get(role, 0) + len(values) - len(valid)
            if len(valid):
                low, high, count = self.ranges.get(role, (np.inf, -np.inf, 0))
                self.ranges[role] = (
                    min(low, float(valid.min())),
                    max(high, float(valid.max())),
                    count + len(valid),
                )

    @property
    def duration_s(self) -> float:
        """Time from the first stamp to the last."""
        first, last = self._span_us or (0, 0)
        return (last - first) * 1e-6

    @property
    def row_rate_hz(self) -> float | None:
        """Mean rate of a table's rows, None where all have one stamp."""
        first, last = self._span_us or (0, 0)
        return (self.rows - 1) * 1e6 / (last - first) if last > first else None
