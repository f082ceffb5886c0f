"""What a page shows at once when it opens: the last ten minutes of rows, and the last day as ranges."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from canest.telemetry.live_protocol import Row

RECENT_S = 600.0
DAY_S = 86_400.0
BUCKET_S = 60.0
_MOST_ROWS = 12_000  #: of the last ten minutes; a source of 10 Hz sends half of it
#: columns of a row that have a range; of the gate the day keeps the share of open rows
RANGED = (
    "mass_kg", "mass_std_kg", "grade", "grade_std", "speed_mps", "torque_Nm", "gear", "residual_N",
)  # fmt: skip


class History:
    """Rows of bounded age and number; a time that goes back overwrites what was there.

    columns: names of a row's values, ``t_s`` first. recent: the rows of the last `RECENT_S`.
    """

    def __init__(self, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        self.recent: deque[Row] = deque(maxlen=_MOST_ROWS)
        self._gate = self.columns.index("gate")
        self._ranged = [self.columns.index(name) for name in RANGED]
        self._day: deque[Row] = deque(maxlen=round(DAY_S / BUCKET_S))
        self._bucket = _Bucket(0.0, len(RANGED))

    def add(self, row: Row) -> None:
        """Take the next row."""
        t_s = row[0] or 0.0
        while self.recent and (self.recent[-1][0] or 0.0) >= t_s:
            self.recent.pop()
        self.recent.append(row)
        while (self.recent[0][0] or 0.0) < t_s - RECENT_S:
            self.recent.popleft()
        begin_s = t_s // BUCKET_S * BUCKET_S
        if begin_s != self._bucket.begin_s:
            self._keep_bucket()
            while self._day and (self._day[-1][0] or 0.0) >= begin_s:
                self._day.pop()
            self._bucket = _Bucket(begin_s, len(RANGED))
        self._bucket.add([row[at] for at in self._ranged], row[self._gate] == 0)

    def day(self) -> list[Row]:
        """Return a row a minute of the last day: ``t_s``, share of open rows, ranges of `RANGED`."""
        return [*self._day, *([self._bucket.row()] if self._bucket.count else [])]

    def _keep_bucket(self) -> None:
        if not self._bucket.count:
            return
        self._day.append(self._bucket.row())
        while (self._day[0][0] or 0.0) < self._bucket.begin_s - DAY_S:
            self._day.popleft()


class _Bucket:
    """Ranges of one minute."""

    def __init__(self, begin_s: float, columns: int) -> None:
        self.begin_s = begin_s
        self.count = self._open = 0
        self._low: Row = [None] * columns
        self._high: Row = [None] * columns

    def add(self, values: Row, is_open: bool) -> None:
        self.count += 1
        self._open += is_open
        for at, value in enumerate(values):
            if value is None:
                continue
            low, high = self._low[at], self._high[at]
            if low is None or value < low:
                self._low[at] = value
            if high is None or value > high:
                self._high[at] = value

    def row(self) -> Row:
        ranges = [end for pair in zip(self._low, self._high, strict=True) for end in pair]
        return [self.begin_s, round(self._open / self.count, 3), *ranges]


class WallClock:
    """Event time of a bus as UTC: the same where they agree within a second, else shifted as a whole."""

    def __init__(self) -> None:
        self._shift_s: float | None = None

    def utc_s(self, t_s: float, newest_s: float, now_s: float) -> float:
        """Return the UTC of event time ``t_s``; ``newest_s`` is the event time at ``now_s`` (UTC)."""
        shift_s = now_s - newest_s
        if self._shift_s is None or abs(shift_s - self._shift_s) > 1.0:
            self._shift_s = 0.0 if abs(shift_s) < 1.0 else shift_s
        return round(t_s + self._shift_s, 2)
