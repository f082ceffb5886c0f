"""When a log is done: the lake has a result of it under the same key.

A key is a digest of all that a result depends on. Whatever of it changes, the log is replayed again.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from canest import __version__
from canest.core.errors import CanestError
from canest.fleet.bundle import Bundle
from canest.fleet.job import Settings
from canest.fleet.tables import SCHEMA_VERSION
from canest.system.result_files import utf8

_PIECE_BYTES = 1 << 20


def result_key(revision: str, bundle: Bundle, vehicle: str, settings: Settings) -> str:
    """Return the digest of all that a result depends on. revision: of the log's content."""
    parts = (
        revision, bundle.digest, Path(bundle.name).name, __version__, SCHEMA_VERSION, vehicle,
        settings.samples_hz, settings.positions,
    )  # fmt: skip
    return hashlib.blake2b(utf8("\n".join(map(str, parts))), digest_size=8).hexdigest()


def content_digest(path: Path) -> str:
    """Return a digest of a file's content. Errors: CanestError."""
    digest = hashlib.blake2b(digest_size=16)
    try:
        with path.open("rb") as file:
            while piece := file.read(_PIECE_BYTES):
                digest.update(piece)
    except OSError as error:
        raise CanestError(f"cannot read: {error.strerror}") from None
    return digest.hexdigest()
