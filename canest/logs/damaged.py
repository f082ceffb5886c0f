"""Opens binary logs that are damaged, cut short or made to harm: what they still hold, and no noise."""

from __future__ import annotations

import contextlib
import io
import itertools
import logging
import re
import sqlite3
import sys
from collections.abc import Iterable, Iterator
from datetime import UTC
from importlib import reload
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from canest.core.errors import LogError

_HEADER_BYTES = 100
#: what python-can and asammdf make of a damaged file, asammdf with tracebacks
_LOGGERS = ("can.io", "asammdf", "canmatrix")
#: messages read at once, for hushing costs as much as reading one
_MESSAGES = 256
#: header of a BLF object: signature, header size and version, then a size of 0, which python-can never passes
_BLF_EMPTY = re.compile(rb"LOBJ.{4}\0{4}", re.DOTALL)
#: the longest text or blob of a row, where a frame needs 64 bytes
_CELL_BYTES_MAX = 1 << 20


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Keep the libraries quiet: what they print and log, and the destructor of what could not be constructed.

    Only for short steps: meanwhile nobody else's output reaches stdout either.
    """
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    enabled = [logger for logger in loggers if not logger.disabled]
    before, sys.unraisablehook = sys.unraisablehook, lambda _: None
    for logger in enabled:
        logger.disabled = True
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        sys.unraisablehook = before
        for logger in enabled:
            logger.disabled = False


@contextlib.contextmanager
def quiet_lines() -> Iterator[None]:
    """Keep python-can's remarks on lines that it passes over to ourselves: they are counted anyway."""
    logger, handler = logging.getLogger("can.io"), logging.NullHandler()
    before, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = before


def quiet_messages(reader: Iterable[Any]) -> Iterator[Any]:
    """Yield what a reader of python-can yields, before whatever it raises."""
    with silenced():
        messages = iter(reader)
    while True:
        held: list[Any] = []
        damage: Exception | None = None
        with silenced():
            try:
                held.extend(itertools.islice(messages, _MESSAGES))
            except Exception as error:  # whatever a damaged file makes of it
                damage = error
        yield from held
        if damage is not None:
            raise damage
        if not held:
            return


def blf_reader(file: Any) -> Any:
    """Return python-can's reader of a BLF file, which ends at an object of size 0 as at other damage."""
    from canest.system.python_can import can  # heavy

    class Reader(can.BLFReader):
        def _parse_data(self, data: bytes) -> Iterator[can.Message]:
            empty = _BLF_EMPTY.search(data)
            if empty is None:
                return super()._parse_data(data)
            return self._parse_until(data[: empty.start()])

        def _parse_until(self, data: bytes) -> Iterator[can.Message]:
            yield from super()._parse_data(data)
            raise can.io.blf.BLFParseError("an object of size 0")

    clipped: Any = _Clipped(file)
    return Reader(clipped)


def mf4_reader(file: Any) -> Any:
    """Return python-can's reader of an MF4 file; a local time without its zone counts as UTC."""
    from canest.system.python_can import can  # heavy

    reader: Any = can.MF4Reader(file)
    start = reader._mdf.header.start_time
    if start.tzinfo is None:  # python-can takes it for one of this machine
        reader._start_timestamp = start.replace(tzinfo=UTC).timestamp()
    return reader


class _Clipped:
    """A file that is never asked for more than it has: what a damaged size announces costs no memory."""

    def __init__(self, file: Any) -> None:
        self._file, self._size = file, file.seek(0, io.SEEK_END)
        file.seek(0)

    def read(self, size: int = -1) -> bytes:
        data: bytes = self._file.read(min(size, self._size))
        return data

    def write(self, _: object) -> int:
        """Take nothing; python-can takes for a file whatever has this."""
        return 0

    def close(self) -> None:
        self._file.close()


def sqlite_reader(path: str, log: Path) -> Any:
    """Return python-can's reader of a database; of one that is cut short, for what its whole pages hold.

    log: what a message names. `file_size` of the reader is what the header announces (SQLite's file format,
    1.3.2 and 1.3.7).
    Errors: LogError where `messages` is no table but a query, which need not have an end.
    """
    from canest.system.python_can import can  # heavy

    file = Path(path)
    size = file.stat().st_size
    with file.open("rb") as opened:
        header = opened.read(_HEADER_BYTES)
    page = int.from_bytes(header[16:18], "big")
    page = 65536 if page == 1 else page
    announced = page * int.from_bytes(header[28:32], "big")
    reader: Any = can.SqliteReader(":memory:")
    try:
        if size >= announced:
            reader._conn.close()
            reader._conn = sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)
            reader._cursor = reader._conn.cursor()
        else:
            if pages := file.read_bytes()[: size - size % page]:
                reader._conn.deserialize(pages)
            reader._cursor.execute("PRAGMA writable_schema=ON")  # otherwise SQLite refuses all of it
        reader._conn.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _CELL_BYTES_MAX)
        reader._conn.set_progress_handler(_let_python_look, 100_000)
        reader._cursor.execute("PRAGMA trusted_schema=OFF")
        refuse_query(reader, log)
    except BaseException:
        reader._conn.close()
        raise
    reader.file_size = announced
    return reader


def refuse_query(reader: Any, log: Path) -> None:
    """Refuse a view or a virtual table. Errors: LogError."""
    kinds = reader._cursor.execute(
        "SELECT type, rootpage FROM sqlite_master "
        "WHERE name = ? COLLATE NOCASE AND type IN ('table', 'view')",
        (reader.table_name,),
    ).fetchall()
    for kind, root in kinds:
        if kind == "view" or not root:
            found = "a view" if kind == "view" else "a virtual table"
            raise LogError(
                f"`{reader.table_name}` is no plain table",
                where=str(log),
                found=found,
                expected="a table of frames",
            )


def _let_python_look() -> int:
    """Be called by SQLite every so many steps; Python takes signals between its own."""
    return 0


def find_asammdf() -> None:
    """Let python-can look for asammdf again.

    It looks once, at its import, and `canest.system.python_can` hides asammdf then.
    """
    from can.io import mf4

    if getattr(mf4, "asammdf", None) is None and find_spec("asammdf") is not None:
        reload(mf4)  # in its own namespace, so that its classes find asammdf wherever they are held
