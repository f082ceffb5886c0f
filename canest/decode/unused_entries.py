"""Entries of a DBC for signals that it does not have, as one has that was cut down to a few messages.

cantools refuses such a file, though nothing that is read depends on them.
"""

from __future__ import annotations

import re
from collections.abc import Collection

#: in cantools' message, one a line: what the entry is, the number of its message, its signal
_NAMED = re.compile(r"^\s+(VAL_|SIG_VALTYPE_) (\d+) (\w+)", re.MULTILINE)
_ENTRY = re.compile(rb'^[ \t]*(VAL_|SIG_VALTYPE_)\s+(\d+)\s+(\w+)\b(?:[^;"]|"[^"]*")*;', re.MULTILINE)
_SHOWN = 3


def unused_entries(message: str) -> list[str]:
    """Return the beginnings of the entries that a message of cantools calls unused, [] for other messages."""
    return [" ".join(entry) for entry in _NAMED.findall(message)] if "unused" in message else []


def without_entries(content: bytes, entries: Collection[str]) -> bytes:
    """Return the content of a DBC without these entries."""
    known = {entry.encode("ascii", "replace") for entry in entries}
    return _ENTRY.sub(lambda found: b"" if b" ".join(found.groups()) in known else found[0], content)


def unused_entry_note(entries: Collection[str]) -> str:
    """Return that entries were not used."""
    shown, more = ", ".join(list(entries)[:_SHOWN]), len(entries) - _SHOWN
    return f"the DBC has no signal for {shown}" + (f" and {more} more" if more > 0 else "")
