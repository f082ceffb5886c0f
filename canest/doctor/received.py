"""What a log or bus has carried: frames, rows, addresses, time, and the range of every role."""

from __future__ import annotations

from collections import Counter

import numpy as np

from canest.core.columns import finite
from canest.core.frames import ERROR, EXTENDED, FrameBlock, IntColumn, MonotonicClock
from canest.core.table_block import TableBlock
from canest.decode import j1939
from canest.doctor.stretches import Samples


class ReceivedValues:
    """What roles have read, of one sender or of all.

    missing_cells: role -> samples without a value. ranges: role -> lowest, highest value and their count.
    last: role -> last value.
    """

    def __init__(self) -> None:
        self.missing_cells: dict[str, int] = {}
        self.ranges: dict[str, tuple[float, float, int]] = {}
        self.last: dict[str, float] = {}

    def note(self, samples: Samples) -> None:
        """Take the samples of the block."""
        for role, (_, values) in samples.items():
            valid = finite(values)
            self.missing_cells[role] = self.missing_cells.get(role, 0) + len(values) - len(valid)
            if len(valid):
                self.last[role] = float(valid[-1])
                low, high, count = self.ranges.get(role, (np.inf, -np.inf, 0))
                self.ranges[role] = (
                    min(low, float(valid.min())),
                    max(high, float(valid.max())),
                    count + len(valid),
                )


class Received:
    """Streams blocks; memory does not grow with the log.

    frames, rows: of a bus or log, and of them rows of a table. error_frames, standard_frames: error frames,
    frames with 11-bit identifiers. standard_ids: those of the latter -> frames. addresses, pgns: of the
    29-bit ones. columns: of a table. values: of the samples. max_backward_s: stamps that go back by no more
    are reordered.
    """

    def __init__(self, max_backward_s: float) -> None:
        self.frames = self.rows = self.error_frames = self.standard_frames = 0
        self.standard_ids: Counter[int] = Counter()
        self.addresses: set[int] = set()
        self.pgns: set[int] = set()
        self.columns: set[str] = set()
        self.values = ReceivedValues()
        self._monotonic = MonotonicClock(max(1, round(max_backward_s * 1e6)))
        #: earliest and latest stamp: as they are, and as time goes on where the clock was set back
        self._stamped_us: tuple[int, int] | None = None
        self._passed_us: tuple[int, int] | None = None

    def push(self, block: FrameBlock | TableBlock) -> None:
        """Count the next block, which is not empty."""
        self._stamped_us = _wider(self._stamped_us, block.t_us)
        self._passed_us = _wider(self._passed_us, self._monotonic(block.t_us))
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
        standard = block.can_id[~extended & ~error] & np.uint32(0x7FF)
        numbers, frames = np.unique(standard, return_counts=True)
        self.standard_ids.update(dict(zip(numbers.tolist(), frames.tolist(), strict=True)))
        identifiers = np.unique(block.can_id[extended])
        self.addresses.update(np.unique(identifiers & np.uint32(0xFF)).tolist())
        groups = np.unique(identifiers >> np.uint32(8) << np.uint32(8))
        self.pgns.update(map(j1939.pgn_of, groups.tolist()))

    @property
    def duration_s(self) -> float:
        """Time from the first stamp to the last; it goes on where the clock was set back."""
        span_us = self._stamped_us if self._monotonic.is_two_clocks else self._passed_us
        first, last = span_us or (0, 0)
        return (last - first) * 1e-6

    @property
    def row_rate_hz(self) -> float | None:
        """Mean rate of a table's rows, None where all have one stamp."""
        return (self.rows - 1) / self.duration_s if self.duration_s > 0.0 else None


def _wider(span_us: tuple[int, int] | None, t_us: IntColumn) -> tuple[int, int]:
    first, last = int(t_us.min()), int(t_us.max())
    return (first, last) if span_us is None else (min(first, span_us[0]), max(last, span_us[1]))
