"""Damaged files of the lake: empty, or cut by a power cut or by a copy that did not end."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from canest.core.errors import CanestError
from canest.fleet.storage import Storage, plain

#: a Parquet file begins and ends with it (github.com/apache/parquet-format)
_MARK = b"PAR1"
_LEAST_BYTES = 12  #: both marks, and the length of the footer


def damaged_files(storage: Storage, sizes: Mapping[str, int]) -> list[str]:
    """Return the files that do not end as a Parquet file does. sizes: file -> bytes.

    In a store, which takes a file as a whole, only those too short are found. Errors: CanestError.
    """
    return [
        name
        for name, size in sizes.items()
        if size < _LEAST_BYTES or (storage.is_local and _is_cut(Path(storage.root, name)))
    ]


def damage(storage: Storage, file: str) -> CanestError:
    """Return the error that names a damaged file."""
    return CanestError(
        "is damaged: it does not end as a Parquet file does", where=storage.url(file),
        expected="a whole file: `canest fleet run` with --resume removes it and makes its results again",
    )  # fmt: skip


def _is_cut(path: Path) -> bool:
    try:
        with path.open("rb", buffering=0) as file:
            file.seek(-len(_MARK), os.SEEK_END)
            return file.read() != _MARK
    except FileNotFoundError:  # joined into another one meanwhile
        return False
    except OSError as error:
        raise CanestError(f"cannot be read: {plain(error)}", where=str(path)) from None
