"""What a log or bus has carried: frames, rows, addresses, time, and the range of every role."""

from __future__ import annotations

import numpy as np

from canest.core.frames import ERROR, EXTENDED, SET_BACKS_MOST, FrameBlock
from canest.core.table_block import TableBlock
from canest.decode import j1939
from canest.doctor.stretches import Samples


class Received:
    """Streams blocks and their samples; memory does not grow with the log.

    frames, rows: of a bus or log, and of them rows of a table. error_frames, standard_frames: error frames,
    frames with 11-bit identifiers. standard_ids: those of the latter. addresses, pgns: of the 29-bit ones.
    columns: of a table. missing_cells: role -> samples without a value. ranges: role -> lowest, highest value
    and their count. last: role -> last value.
    """

    def __init__(self, max_backward_s: float) -> None:
        self._most_reordered_us = round(max_backward_s * 1e6)
        self.frames = self.rows = self.error_frames = self.standard_frames = 0
        self.standard_ids: set[int] = set()
        self.addresses: set[int] = set()
        self.pgns: set[int] = set()
        self.columns: set[str] = set()
        self.missing_cells: dict[str, int] = {}
        self.ranges: dict[str, tuple[float, float, int]] = {}
        self.last: dict[str, float] = {}
        self._span_us: tuple[int, int] | None = None  #: earliest and latest stamp
        self._ends_us: tuple[int, int] | None = None  #: first and last stamp, in the order of arrival
        self._set_backs = self._set_back_us = 0

    def push(self, block: FrameBlock | TableBlock) -> None:
        """Count the next block, which is not empty."""
        first, last = int(block.t_us.min()), int(block.t_us.max())
        known = self._span_us or (first, last)
        self._span_us = min(first, known[0]), max(last, known[1])
        begin, before = self._ends_us or (int(block.t_us[0]), int(block.t_us[0]))
        self._ends_us = begin, int(block.t_us[-1])
        back_us = -np.diff(block.t_us, prepend=before)
        back_us = back_us[back_us > self._most_reordered_us]
        self._set_backs += len(back_us)
        self._set_back_us += int(back_us.sum())
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
                self.last[role] = float(valid[-1])
                low, high, count = self.ranges.get(role, (np.inf, -np.inf, 0))
                self.ranges[role] = (
                    min(low, float(valid.min())),
                    max(high, float(valid.max())),
                    count + len(valid),
                )

    @property
    def duration_s(self) -> float:
        """Time from the first stamp to the last; it goes on where the clock was set back."""
        first, last = self._span_us or (0, 0)
        if 0 < self._set_backs < SET_BACKS_MOST:
            first, last = self._ends_us or (0, 0)
            last += self._set_back_us
        return (last - first) * 1e-6

    @property
    def row_rate_hz(self) -> float | None:
        """Mean rate of a table's rows, None where all have one stamp."""
        return (self.rows - 1) / self.duration_s if self.duration_s > 0.0 else None
