"""One candump line, read tolerantly: the definition of "well-formed" that the fast path must agree with.

Both text forms of can-utils' ``candump`` are understood, with everything its options add::

    (1700000000.000102) can0 18FEEE31#BCC1FFFF        log form (-L, -l)
    (1700000000.000102) can0 123#R8 T                  remote frame, direction
    (1700000000.000102) can0 18FEEE31##1BCC1           CAN FD, one hex digit of flags
     (000.005001)  can0  18FEDF00   [8]  8A A0 28 7D 7D FF FF F5   '..(}}...'      screen form (-t, -a)
     (000.005001)  can0  18FEDF00  [12]  8A A0 28 7D 7D FF FF F5      CAN FD of which eight bytes are known
     (000.005001)  can0  RX - -  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import NamedTuple

from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE

CLASSIC_BYTES = 8
FD_LENGTHS = frozenset((*range(9), 12, 16, 20, 24, 32, 48, 64))
STANDARD_ID_MAX = 0x7FF
#: whole seconds that still fit int64 microseconds with room to spare
SECONDS_DIGITS_MAX = 12

_STAMP = (
    rb"\s*\((?:(?P<sec>\d+)|(?P<date>\d{4}-\d\d-\d\d \d\d:\d\d:\d\d))\.(?P<frac>\d{1,9})\)"
    rb"\s+(?P<channel>\S+)\s+"
)
_LOG = re.compile(
    _STAMP
    + rb"(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})(?P<mark>##[0-9A-Fa-f]|#)"
    + rb"(?:[Rr](?P<dlc>[0-9A-Fa-f]?)|(?P<data>(?:[0-9A-Fa-f]{2}\.?)*))(?:_[0-9A-Fa-f])?(?:\s+[RTrt])?\s*"
)
_SCREEN = re.compile(
    _STAMP
    + rb"(?:[RT]X\s+[B-]\s+[E-]\s+)?(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})\s+\[(?P<dlc>\d{1,2})\]"
    + rb"(?:\s+(?P<remote>remote request)|(?P<data>(?:\s+[0-9A-Fa-f]{2}(?=\s|\Z))*))"
    + rb"(?:\s+(?:(?P<ascii>'.*')|ERRORFRAME.*))?\s*",
    re.DOTALL,
)
_COLOUR = re.compile(rb"\x1b\[[0-9;]*m")
_NEGATIVE_STAMP = re.compile(rb"\s*\(-\d")
_NO_STAMP = re.compile(rb"\s*\S+\s+(?:[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})(?:#|\s+\[\d)")
_WHITE = b" \t\r\n\x0b\x0c"


class Line(NamedTuple):
    """A well-formed line: the frame, and where its parts stood (for `canest.logs.candump_layout`)."""

    t_us: int
    can_id: int
    length: int
    data: int
    channel: bytes
    match: re.Match[bytes]


def is_ignorable(text: bytes) -> bool:
    """Return True for a line that holds no frame and is no fault: blank, or detail of an error frame (-e)."""
    return text[:1] == b"\t" or not text.strip(_WHITE)


def parse_line(text: bytes) -> Line | str:
    """Return the frame of one line (without its newline), or in a few words why there is none."""
    if b"\x1b" in text:
        text = _COLOUR.sub(b"", text)
    match = _LOG.fullmatch(text) or _SCREEN.fullmatch(text)
    if match is None:
        if _NEGATIVE_STAMP.match(text):
            return "negative time stamp"
        return "no time stamp" if _NO_STAMP.match(text) else "not a candump line"
    part = match.groupdict()
    t_us = _microseconds(part["sec"], part["date"], part["frac"])
    if t_us is None:
        return "impossible time stamp"
    can_id = _identifier(part["id"])
    if can_id is None:
        return "impossible identifier"
    payload = bytes.fromhex((part["data"] or b"").replace(b".", b" ").decode())
    mark = part.get("mark")
    remote = bool(part.get("remote")) or (mark == b"#" and part["data"] is None)
    if mark is None:
        declared = int(part["dlc"])
        # our own recordings hold eight bytes of a long frame, which is all that anything here looks at
        brief = declared > CLASSIC_BYTES == len(payload)
        if not remote and declared != len(payload) and not brief:
            return f"{len(payload)} data bytes where [{declared}] are announced"
    elif part["data"] is None and not remote:
        return "remote request in CAN FD"
    fd = mark not in (None, b"#") or (mark is None and len(part["dlc"]) > 1)
    if remote:
        length = int(part["dlc"] or b"0", 16)
    else:
        length = len(payload) if mark is not None else int(part["dlc"])
    if (length not in FD_LENGTHS) if fd else (length > CLASSIC_BYTES):
        return f"impossible length of {length} data bytes"
    flags = REMOTE if remote else 0
    return Line(t_us, can_id | flags, length, int.from_bytes(payload[:8], "little"), part["channel"], match)


def _identifier(digits: bytes) -> int | None:
    value = int(digits, 16)
    if len(digits) == 3:
        return value if value <= STANDARD_ID_MAX else None
    if value & ~(ID_MASK | ERROR):
        return None
    return value if value & ERROR else value | EXTENDED


def _microseconds(seconds: bytes | None, date: bytes | None, fraction: bytes) -> int | None:
    if seconds is None:
        try:  # candump -tA prints local time without its zone; UTC keeps differences right
            whole = int(
                datetime.strptime((date or b"").decode(), "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
            )
        except ValueError:
            return None
    elif len(seconds) > SECONDS_DIGITS_MAX:
        return None
    else:
        whole = int(seconds)
    return whole * 1_000_000 + int(fraction[:6].ljust(6, b"0"))
