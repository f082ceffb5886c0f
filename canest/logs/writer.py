"""Results as files, streamed: estimates as csv or parquet, frames as a candump log.

A file appears under its name only when it is complete.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AbstractContextManager, suppress
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from canest.core.errors import OutputError
from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, FrameBlock
from canest.core.gates import LABELS
from canest.core.samples import STATUS_LABELS
from canest.logs import ascii as text
from canest.logs.lines import CLASSIC_BYTES
from canest.system.installation import how_to_add
from canest.system.result_files import open_result, output_errors

if TYPE_CHECKING:
    from canest.core.estimates import Estimates


HEADER = b"t_s,mass_kg,mass_std_kg,grade,grade_std,status,gate\n"
MASS_DECIMALS = 1
GRADE_DECIMALS = 6
_ROWS_AT_ONCE = 1 << 13
_FRAMES_AT_ONCE = 1 << 13
#: rows of one parquet row group
_ROW_GROUP = 1 << 17


class EstimateWriter(ABC):
    """Takes estimates in order; use as a context manager. An exception inside leaves no file.

    Errors: OutputError when the file cannot be written (full disk, no permission).
    """

    def __init__(self, path: Path) -> None:
        self._out = _Growing(path)

    @abstractmethod
    def write(self, estimates: Estimates) -> None:
        """Append the next rows."""

    def _finish(self) -> None:  # noqa: B027 - only formats that hold something back need it
        """Write what is held back."""

    def _abandon(self) -> None:  # noqa: B027 - as above
        """Let go of what cannot be finished."""

    def __enter__(self) -> EstimateWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._abandon()
            self._out.discard()
            return
        try:
            self._finish()
        except BaseException:
            self._abandon()
            self._out.discard()
            raise
        self._out.commit()


def open_writer(path: str | Path) -> EstimateWriter:
    """Open a result file: parquet when its name ends so, else csv."""
    path = Path(path)
    return ParquetEstimateWriter(path) if path.suffix.lower() == ".parquet" else CsvEstimateWriter(path)


class CsvEstimateWriter(EstimateWriter):
    """est.csv: one row per sample, numbers empty where there is none."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._out.write(HEADER)

    def write(self, estimates: Estimates) -> None:
        """Append the next rows."""
        for first in range(0, len(estimates), _ROWS_AT_ONCE):
            self._out.write(estimates_csv(estimates, slice(first, first + _ROWS_AT_ONCE)))


def estimates_csv(estimates: Estimates, rows: slice) -> bytes:
    """Return rows of est.csv."""
    t_us = estimates.t_us[rows]
    comma = text.constant(b",", len(t_us))
    return text.join(
        [
            text.seconds(t_us),
            comma,
            text.fixed(estimates.mass_kg[rows], MASS_DECIMALS),
            comma,
            text.fixed(estimates.mass_std_kg[rows], MASS_DECIMALS),
            comma,
            text.fixed(estimates.grade[rows], GRADE_DECIMALS),
            comma,
            text.fixed(estimates.grade_std[rows], GRADE_DECIMALS),
            comma,
            text.labels(estimates.status[rows], STATUS_LABELS),
            comma,
            text.labels(estimates.gate[rows], LABELS),
            text.constant(b"\n", len(t_us)),
        ]
    )


class ParquetEstimateWriter(EstimateWriter):
    """The same columns as parquet (pyarrow, extra ``formats``), in row groups."""

    def __init__(self, path: Path) -> None:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError:
            raise OutputError(
                "cannot write parquet",
                where=str(path),
                expected=f"the pyarrow package: {how_to_add('formats')}",
            ) from None
        super().__init__(path)
        self._pa = pa
        names = pa.dictionary(pa.int8(), pa.string())
        numbers = ("t_s", "mass_kg", "mass_std_kg", "grade", "grade_std")
        self._schema = pa.schema(
            [(name, pa.float64()) for name in numbers] + [("status", names), ("gate", names)]
        )
        with self._out.errors():
            self._writer = pq.ParquetWriter(self._out.file, self._schema)
        self._held: list[Any] = []
        self._rows = 0

    def write(self, estimates: Estimates) -> None:
        """Append the next rows."""
        e = estimates
        numbers = [e.t_us / 1e6, e.mass_kg, e.mass_std_kg, e.grade, e.grade_std]
        columns = [self._pa.array(column, from_pandas=True) for column in numbers]
        columns.append(self._names(e.status, STATUS_LABELS))
        columns.append(self._names(e.gate, LABELS))
        self._held.append(self._pa.record_batch(columns, schema=self._schema))
        self._rows += len(e)
        if self._rows >= _ROW_GROUP:
            self._flush()

    def _names(self, codes: Any, names: dict[int, str]) -> Any:
        known = [names.get(code, "") for code in range(max(names) + 1)]
        return self._pa.DictionaryArray.from_arrays(codes.astype(np.int8), known)

    def _flush(self) -> None:
        with self._out.errors():
            self._writer.write_table(self._pa.Table.from_batches(self._held, self._schema))
        self._held, self._rows = [], 0

    def _abandon(self) -> None:
        with suppress(OSError):
            self._writer.close()

    def _finish(self) -> None:
        self._flush()
        with self._out.errors():
            self._writer.close()


class CandumpWriter:
    """A candump log (its log form); use as a context manager, as `EstimateWriter`."""

    def __init__(self, path: str | Path, channel: str = "can0") -> None:
        self._out = _Growing(Path(path))
        self._channel = channel

    def write(self, frames: FrameBlock) -> None:
        """Append the next frames."""
        for first in range(0, len(frames), _FRAMES_AT_ONCE):
            self._out.write(candump_text(frames[first : first + _FRAMES_AT_ONCE], self._channel))

    def __enter__(self) -> CandumpWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._out.commit()
        else:
            self._out.discard()


def candump_text(frames: FrameBlock, channel: str = "can0") -> bytes:
    """Return frames as candump lines: its log form, and its screen form for CAN FD beyond eight bytes.

    A block holds eight bytes of a frame, and no others are made up: the screen form announces the length
    as sent, and reads back as the same frame.
    """
    long = (frames.length > CLASSIC_BYTES) & ((frames.can_id & np.uint32(REMOTE)) == 0)
    if not long.any():
        return _log_form(frames, channel)
    edges = [0, *(np.flatnonzero(long[1:] != long[:-1]) + 1).tolist(), len(frames)]
    return b"".join(
        (_screen_form if long[first] else _log_form)(frames[first:end], channel)
        for first, end in pairwise(edges)
    )


def _screen_form(frames: FrameBlock, channel: str) -> bytes:
    """Return CAN FD frames with the first eight of their bytes."""
    columns = (frames.t_us, frames.can_id, frames.length, frames.data)
    lines = []
    for t_us, can_id, length, word in zip(*(column.tolist() for column in columns), strict=True):
        number = f"{can_id & ID_MASK:08X}" if can_id & EXTENDED else f"{can_id & ID_MASK:03X}"
        payload = word.to_bytes(CLASSIC_BYTES, "little").hex(" ").upper()
        seconds, micros = divmod(t_us, 1_000_000)
        lines.append(f"({seconds:010d}.{micros:06d})  {channel}  {number}  [{length}]  {payload}\n")
    return "".join(lines).encode()


def _log_form(frames: FrameBlock, channel: str) -> bytes:
    count = len(frames)
    t_us = frames.t_us
    whole = t_us // 1_000_000
    error = (frames.can_id & np.uint32(ERROR)) != 0
    standard = (frames.can_id & np.uint32(EXTENDED | ERROR)) == 0
    remote = (frames.can_id & np.uint32(REMOTE)) != 0
    number = (frames.can_id & np.uint32(ID_MASK)) | np.where(error, np.uint32(ERROR), np.uint32(0))
    identifier = text.hexadecimal(number.astype(">u4").view(np.uint8).reshape(count, 4)).copy()
    identifier[:, :5][standard] = 0
    payload = text.hexadecimal(frames.data.astype("<u8").view(np.uint8).reshape(count, 8)).copy()
    unsent = np.arange(16) >= 2 * frames.length[:, None]
    payload[unsent | remote[:, None]] = 0
    request = text.blank_where(text.constant(b"R", count), ~remote)
    announced = text.digits(frames.length.astype(np.int64), 1)
    return text.join(
        [
            text.constant(b"(", count),
            text.integer(whole, 10),
            text.constant(b".", count),
            text.digits(t_us - whole * 1_000_000, 6),
            text.constant(f") {channel} ".encode(), count),
            identifier,
            text.constant(b"#", count),
            payload,
            request,
            text.blank_where(announced, ~remote),
            text.constant(b"\n", count),
        ]
    )


class _Growing:
    """A result while it grows. Errors: OutputError."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self.errors():
            self._result = open_result(path)
        self.file = self._result.file

    def errors(self) -> AbstractContextManager[None]:
        """Turn the system's complaints into one line."""
        return output_errors(self._path)

    def write(self, data: bytes) -> None:
        with self.errors():
            self.file.write(data)

    def commit(self) -> None:
        with self.errors():
            self._result.commit()

    def discard(self) -> None:
        self._result.discard()
