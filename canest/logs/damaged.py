"""Opens binary logs that are damaged or cut short: what they still hold, and no noise."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_HEADER_BYTES = 100


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Keep asammdf quiet: what it prints, and the destructor of what it could not construct.

    Only for opening: meanwhile nobody else's output is heard either.
    """
    before, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        sys.unraisablehook = before


def sqlite_reader(path: str) -> Any:
    """Return python-can's reader of a database; of one that is cut short, for what its whole pages hold.

    `file_size` of the reader is what the header announces (SQLite's file format, 1.3.2 and 1.3.7).
    """
    import can

    file = Path(path)
    size = file.stat().st_size
    with file.open("rb") as opened:
        header = opened.read(_HEADER_BYTES)
    page = int.from_bytes(header[16:18], "big")
    page = 65536 if page == 1 else page
    announced = page * int.from_bytes(header[28:32], "big")
    whole = size >= announced
    reader: Any = can.SqliteReader(path if whole else ":memory:")
    if not whole:
        if pages := file.read_bytes()[: size - size % page]:
            reader._conn.deserialize(pages)
        reader._cursor.execute("PRAGMA writable_schema=ON")  # otherwise SQLite refuses all of it
    reader.file_size = announced
    return reader
