"""Tables of already decoded signals as parquet (pyarrow, extra ``formats``)."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Generator, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from canest.core.errors import LogError
from canest.core.table_block import TableBlock
from canest.logs.cells import number_of, seconds_of
from canest.logs.table_reader import TableFileReader
from canest.system.installation import how_to_add

_READ_BYTES = 1 << 20


class ParquetReader(TableFileReader):
    """A parquet file, batch by batch; a truncated one holds nothing, since its index stands at the end."""

    format = "parquet"

    def _blocks(self) -> Generator[TableBlock]:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError:
            raise LogError(
                "log is a parquet file",
                where=str(self.path),
                expected=f"the pyarrow package: {how_to_add('formats')}",
            ) from None
        try:
            with self._stored() as stored:
                file = pq.ParquetFile(stored)
                self.columns = list(file.schema_arrow.names)
                names = [self.columns[position] for position in self._choose()]
                meter = self._source.meter
                meter.refuse_memory(_largest_group_bytes(file.metadata, names, meter.memory_bytes))
                seen = 0
                for batch in file.iter_batches(batch_size=self._block_rows, columns=names):
                    texts = self._texts_of(batch, names)
                    values = np.column_stack(
                        [
                            np.full(len(batch), np.nan)
                            if name in texts
                            else self._cells(batch.column(name), name, seen)
                            for name in names
                        ]
                    )
                    numbers = np.arange(seen + 1, seen + 1 + len(values))
                    seen += len(values)
                    yield self._block(names, values, numbers, texts)
        except MemoryError:
            raise
        except (pa.ArrowException, OSError, RuntimeError) as error:  # the last from its C++, of odd metadata
            if not self.frames:
                raise LogError("no readable parquet file", where=str(self.path), found=str(error)) from None
            self.truncated_reason = f"damaged parquet file ({error})".replace("\n", " ")

    def _cells(self, column: Any, name: str, seen: int) -> NDArray[np.float64]:
        """Return a column as float64; text, where it is no number, is counted. seen: rows before it."""
        floats = _floats(column)
        if floats is not None:
            return floats
        numbers = np.full(len(column), np.nan)
        read = seconds_of if name == self._time_column else number_of
        for row, cell in enumerate(column.to_pylist()):
            value = None if cell is None else read(str(cell))
            if value is not None:
                numbers[row] = value
            elif cell is not None and str(cell).strip():
                self._note_text(name, seen + row + 1, str(cell))
        return numbers

    def _texts_of(self, batch: Any, names: list[str]) -> dict[str, NDArray[np.str_]]:
        """Return the cells of columns that are wanted as text and hold no numbers; '' for nothing."""
        found = {}
        for name in self._as_text.intersection(names[1:]):
            column = batch.column(name)
            if _floats(column) is None:
                cells = ("" if cell is None else str(cell) for cell in column.to_pylist())
                found[name] = np.array(list(cells), np.str_)
        return found

    @contextmanager
    def _stored(self) -> Iterator[Any]:
        """Yield a file that can be read at any place: of an archive or a pipe a copy."""
        if self._source.is_plain:
            yield self.path
            return
        with tempfile.TemporaryFile() as unpacked:
            unpacked.write(self._head)
            while piece := self._source.read(_READ_BYTES):
                unpacked.write(piece)
            unpacked.seek(0)
            yield unpacked


def _largest_group_bytes(metadata: Any, names: Collection[str], limit: float) -> int:
    """Return what the columns of the largest row group take up, unpacked; 0 where none exceeds the limit.

    pyarrow ends the process over the metadata of a damaged column, so only a file beyond the limit is looked
    at column by column.
    """
    groups = [metadata.row_group(group) for group in range(metadata.num_row_groups)]
    largest = 0
    for group in groups:
        if group.total_byte_size <= limit:
            continue
        columns = [group.column(k) for k in range(metadata.num_columns)]
        largest = max(
            largest,
            sum(c.total_uncompressed_size for c in columns if c.path_in_schema.split(".")[0] in names),
        )
    return largest


def _floats(column: Any) -> NDArray[np.float64] | None:
    """Return a column as float64, times and durations in seconds, NaN for nothing; None for text."""
    import pyarrow as pa

    if pa.types.is_date(column.type):
        count, unit_s = (pa.int32(), 86_400.0) if pa.types.is_date32(column.type) else (pa.int64(), 1e-3)
        floats = column.cast(count).cast(pa.float64(), safe=False)
        return np.asarray(floats.to_numpy(zero_copy_only=False)) * unit_s
    if pa.types.is_timestamp(column.type) or pa.types.is_duration(column.type):
        stamps = pa.types.is_timestamp(column.type)
        precise = pa.timestamp("us", column.type.tz) if stamps else pa.duration("us")
        micros = column.cast(precise, safe=False).cast(pa.int64())
        return np.asarray(micros.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)) / 1e6
    try:
        floats = column.cast(pa.float64(), safe=False)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    return np.array(floats.to_numpy(zero_copy_only=False), np.float64)
