"""Which logs there are below SOURCE: a folder, a pattern, one file, here or in object storage."""

from __future__ import annotations

import posixpath
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

from canest.core.errors import LogError, UsageError
from canest.fleet.result_names import MARKER
from canest.fleet.storage import Storage, plain, retried
from canest.logs.compression import ARCHIVE_SUFFIXES
from canest.logs.log_names import TRUTH_SUFFIX
from canest.offline.replay import ARCHIVE_RATIO

#: what a file in a folder must end with to be taken for a log; a pattern takes whatever it fits
LOG_SUFFIXES = (
    ".log", ".candump", ".dump", ".asc", ".blf", ".trc", ".mf4", ".csv", ".db", ".parquet",
)  # fmt: skip
#: those of logs that are much shorter than the same as text
_PACKED_SUFFIXES = (*ARCHIVE_SUFFIXES, ".blf", ".mf4", ".parquet")
_WILD = "*?["


@dataclass(frozen=True, slots=True)
class FoundLog:
    """A log. name: its path below SOURCE. revision: the store's own version of its content, '' here."""

    name: str
    url: str
    size: int
    revision: str = ""

    @property
    def text_bytes(self) -> float:
        """Return about how large it would be as text: how much work it is."""
        return self.size * (ARCHIVE_RATIO if self.name.lower().endswith(_PACKED_SUFFIXES) else 1.0)


@dataclass(slots=True)
class Listing:
    """What SOURCE holds. passed_over: names in its folders that no log has."""

    logs: list[FoundLog] = field(default_factory=list)
    passed_over: list[str] = field(default_factory=list)


def find_logs(source: str) -> Listing:
    """Return the logs below a folder, those that fit a pattern (** for any depth), or the one file.

    Errors: LogError where there is nothing; UsageError for a protocol that is not known.
    """
    storage = Storage.of(_fixed_part(source))
    base, files = posixpath.normpath(storage.root), storage.files
    # a folder's own name may hold brackets
    wild = storage.root != Storage.of(source).root and not files.exists(Storage.of(source).root)
    try:
        if wild:
            found = retried(lambda: files.glob(Storage.of(source).root, detail=True))
        else:
            base = posixpath.normpath(Storage.of(source).root)
            found = retried(lambda: files.find(base, detail=True))
            if set(found) == {base}:  # one file
                base, wild = posixpath.dirname(base), True
    except Exception as error:
        raise LogError(f"cannot be listed: {plain(error)}", where=source) from None
    listing = Listing()
    lakes = [f"{posixpath.dirname(path)}/" for path in found if posixpath.basename(path) == MARKER]
    for path in sorted(found):
        info = found[path]
        if info.get("type") == "directory":
            continue
        name = path[path.index(base) + len(base) :].lstrip("/")
        if any(path.startswith(lake) for lake in lakes):
            continue  # results of a run, and no logs
        elif wild or _is_log(name):
            url = f"{storage.protocol}://{path}" if storage.protocol else path
            listing.logs.append(FoundLog(name, url, int(info.get("size") or 0), _revision(storage, info)))
        else:
            listing.passed_over.append(name)
    if not listing.logs:
        raise LogError("no logs there", where=source, expected=f"files that end in {' '.join(LOG_SUFFIXES)}")
    return listing


def fits(name: str, pattern: str) -> bool:
    """Return whether a log's path below SOURCE fits a pattern; one without '/' looks at the file's name."""
    return fnmatchcase(name if "/" in pattern else posixpath.basename(name), pattern) or name == pattern


def _is_log(name: str) -> bool:
    if any(part.startswith((".", "_")) for part in name.split("/")):
        return False
    plain_name = name.lower()
    for suffix in ARCHIVE_SUFFIXES:
        plain_name = plain_name.removesuffix(suffix)
    return plain_name.endswith(LOG_SUFFIXES) and not plain_name.endswith(TRUTH_SUFFIX)


def _fixed_part(source: str) -> str:
    """Return the folder above the first part that is a pattern."""
    parts = source.split("/")
    first = next((i for i, part in enumerate(parts) if any(c in part for c in _WILD)), len(parts))
    fixed = "/".join(parts[:first])
    if not source:
        raise UsageError("is empty", where="SOURCE", expected="a folder, a pattern or a URL")
    return fixed or ("/" if source.startswith("/") else ".")


def _revision(storage: Storage, info: dict[str, Any]) -> str:
    """Return what identifies an object's content without reading it, '' where only reading does."""
    if storage.is_local:
        return ""
    for key in ("ETag", "etag", "md5Hash", "content_md5"):
        if info.get(key):
            return str(info[key]).strip('"')
    return ""
