"""When a log is done: the lake has a result of it under the same key.

A key is a digest of all that a result depends on. Whatever of it changes, the log is replayed again.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from canest import __version__
from canest.core.errors import CanestError
from canest.fleet.bundle import Bundle
from canest.fleet.job import FleetJob, Settings
from canest.fleet.tables import SCHEMA_VERSION

_PIECE_BYTES = 1 << 20


def log_id(name: str) -> str:
    """Return what stands for a log's path in names of files."""
    return hashlib.blake2b(name.encode("utf-8", "surrogateescape"), digest_size=6).hexdigest()


def result_key(job: FleetJob, path: Path, bundle: Bundle, vehicle: str, settings: Settings) -> str:
    """Return the digest of all that a result depends on: content, config, version, settings."""
    content = job.log.revision or content_digest(path)
    parts = (
        content, bundle.digest, bundle.name, __version__, SCHEMA_VERSION, vehicle, settings.samples_hz,
        settings.positions,
    )  # fmt: skip
    return hashlib.blake2b("\n".join(map(str, parts)).encode(), digest_size=8).hexdigest()


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
