"""What the files of results are called. A result is what one log gave with one key: `LOG-KEY`, both digests.

A file has one result and is called after it, or is a part with several: `part-DIGEST`, of their names.
"""

from __future__ import annotations

import hashlib
import posixpath
from collections.abc import Iterable, Mapping

from canest.system.result_files import utf8

MARKER = "canest-lake.json"  #: the file by which a folder is a lake
SUFFIX = ".parquet"
_PART = "part-"


def log_id(name: str) -> str:
    """Return what stands for a log's path in names of files."""
    return hashlib.blake2b(utf8(name), digest_size=6).hexdigest()


def result_of(log: str, key: str) -> str:
    """Return the name of a result. log: its path below SOURCE."""
    return f"{log_id(log)}-{key}"


def log_of(result: str) -> str:
    """Return the digest of the log of a result."""
    return result.partition("-")[0]


def result_in(file: str) -> str:
    """Return the one result that a file is called after; '' for a part, and for what is no result."""
    name = posixpath.basename(file)
    return name.removesuffix(SUFFIX) if name.endswith(SUFFIX) and not is_part(name) and "-" in name else ""


def part_of(results: Iterable[str]) -> str:
    """Return the file name of a part with these results."""
    digest = hashlib.blake2b("\n".join(sorted(results)).encode(), digest_size=8)
    return f"{_PART}{digest.hexdigest()}{SUFFIX}"


def is_part(file: str) -> bool:
    """Return whether a file has several results."""
    name = posixpath.basename(file)
    return name.startswith(_PART) and name.endswith(SUFFIX)


def superseded(results: Mapping[str, frozenset[str]]) -> set[str]:
    """Return the files of one folder whose results all stand in others too. results: file -> its results.

    The smaller ones go first, so that of two equal files one stays.
    """
    copies: dict[str, int] = {}
    for held in results.values():
        for result in held:
            copies[result] = copies.get(result, 0) + 1
    found: set[str] = set()
    for file in sorted(results, key=lambda file: (len(results[file]), file)):
        held = results[file]
        if held and all(copies[result] > 1 for result in held):
            found.add(file)
            for result in held:
                copies[result] -= 1
    return found
