"""Frames in separated text with a header line: where in a line the time, identifier and bytes stand.

Vehicle Spy writes a preamble, a header line for each kind of network, and one column for each byte. The
trace window of CANalyzer and CANoe exports the columns that it shows, with the separator and the decimal
point of the computer's language, identifiers and bytes hexadecimal or decimal as shown.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

from canest.core.frames import EXTENDED, REMOTE

_SEPARATORS = (",", ";", "\t")
#: a preamble is shorter, and so is a header line
_HEAD_BYTES, _HEADER_LINES, _HEADER_CHARS = 1 << 17, 1000, 4096
#: rows that decide between hexadecimal and decimal
_SAMPLE_ROWS = 500
#: columns by their names without spaces and signs, in lower case; times with the seconds in one unit
_TIMES = {
    "abstimesec": 1.0, "time": 1.0, "times": 1.0, "timesec": 1.0, "timeabs": 1.0, "timestamp": 1.0,
    "timestamps": 1.0, "timems": 1e-3, "timestampms": 1e-3, "timeus": 1e-6,
}  # fmt: skip
_IDS = ("arbid", "id", "canid", "idhex", "iddec", "identifier")
_DATA = ("data", "databytes", "datahex", "datadec", "payload")
_EXTENDED = ("xtd", "extended", "ext")
_REMOTE = ("remote", "remoteedlbrsesi", "rtr")
_ERROR = ("er", "error")
_CHANNELS = ("network", "chn", "channel", "bus")
_LENGTHS = ("datalength", "dlc", "len", "length")
_YES = frozenset(("t", "true", "1", "yes", "x"))
_STANDARD_MAX, _EXTENDED_MAX = 0x7FF, 0x1FFF_FFFF
_LONGEST = 64
_NAMED_BASES = {"idhex": 16, "iddec": 10, "datahex": 16, "datadec": 10}


@dataclass(frozen=True, slots=True)
class FrameTable:
    """How the lines of one file are laid out; positions are of cells, None where there is no such column."""

    separator: str
    cells: int
    seconds: float  #: per unit of the time column
    time: int
    identifier: int
    data: tuple[int, ...]  #: one cell with all bytes, or one for each
    extended: int | None
    remote: int | None
    error: int | None
    channel: int | None
    length: int | None
    id_base: int = 16
    data_base: int = 16

    def frame(self, cells: Sequence[str]) -> tuple[float, int, bytes] | None:
        """Return seconds, identifier with flags and payload of a row, None for a row that is no data frame.

        Errors: ValueError with what is wrong.
        """
        if len(cells) < self.cells:
            raise ValueError(f"{len(cells)} cells, expected at least {self.cells}")
        if self.error is not None and _is_set(cells[self.error]):
            return None
        if not cells[self.identifier].strip():
            return None  # an event of another kind: a statistic, a comment
        seconds = float(_number(cells[self.time])) * self.seconds
        can_id = self._identifier(cells)
        if self.remote is not None and _is_set(cells[self.remote].partition("/")[0]):
            return seconds, can_id | REMOTE, b""
        return seconds, can_id, self._payload(cells)

    def _identifier(self, cells: Sequence[str]) -> int:
        text, base, marked = _plain_id(cells[self.identifier], self.id_base)
        number = int(text, base)
        if self.extended is not None:
            flag = cells[self.extended].strip().lower()
            if flag not in _YES and flag not in ("f", "false", "0", "no", ""):
                raise ValueError(f"no CAN frame: {flag!r} does not give the identifier's length")
            marked = marked or flag in _YES
        elif number > _STANDARD_MAX:
            marked = True
        if number > (_EXTENDED_MAX if marked else _STANDARD_MAX):
            raise ValueError(f"no identifier: {text}")
        return number | EXTENDED if marked else number

    def _payload(self, cells: Sequence[str]) -> bytes:
        if len(self.data) > 1:
            texts = [cells[at].strip() for at in self.data if at < len(cells)]
            while texts and not texts[-1]:
                texts.pop()
        else:
            texts = _byte_texts(cells[self.data[0]])
        if self.length is not None and cells[self.length].strip().isdigit():
            texts = texts[: int(cells[self.length])]
        if len(texts) > _LONGEST:
            raise ValueError(f"{len(texts)} bytes")
        return bytes(int(text, self.data_base) for text in texts)


def frame_table(head: bytes) -> FrameTable | None:
    """Return how the text of a file begins to be laid out, None where it has no such header."""
    lines = head[:_HEAD_BYTES].decode("utf-8", "replace").replace("\r", "").split("\n")
    for number, line in enumerate(lines[:_HEADER_LINES]):
        found = _layout(line) if len(line) <= _HEADER_CHARS else None
        if found is not None:
            rows = (cells_of(row, found) for row in islice(lines, number + 1, number + 1 + _SAMPLE_ROWS))
            return _with_bases(found, [cells for cells in rows if len(cells) >= found.cells], _names(line))
    return None


def cells_of(line: str, table: FrameTable) -> list[str]:
    """Return the cells of a line. Errors: csv.Error."""
    return next(csv.reader([line], delimiter=table.separator), [])


def _names(line: str) -> list[str]:
    separator = max(_SEPARATORS, key=line.count)
    cells = next(csv.reader([line], delimiter=separator), []) if separator in line else []
    return [re.sub(r"[^a-z0-9]", "", cell.lower()) for cell in cells]


def _layout(line: str) -> FrameTable | None:
    """Return the layout of a header line, None for a line that is none."""
    try:
        names = _names(line)
    except csv.Error:
        return None
    time = next((name for name in names if name in _TIMES), None)
    identifier = _first(names, _IDS)
    data = tuple(names.index(f"b{k}") for k in range(1, _LONGEST + 1) if f"b{k}" in names)
    whole = _first(names, _DATA)
    if not data and whole is not None:
        data = (whole,)
    if time is None or identifier is None or not data:
        return None
    extended, remote = _first(names, _EXTENDED), _first(names, _REMOTE)
    error, channel = _first(names, _ERROR), _first(names, _CHANNELS)
    length = None if len(data) > 1 else _first(names, _LENGTHS)
    needed = [
        names.index(time),
        identifier,
        data[0],
        *(at for at in (extended, remote, error, channel, length) if at is not None),
    ]
    separator = max(_SEPARATORS, key=line.count)
    return FrameTable(
        separator=separator,
        cells=max(needed) + 1,
        seconds=_TIMES[time],
        time=names.index(time),
        identifier=identifier,
        data=data,
        extended=extended,
        remote=remote,
        error=error,
        channel=channel,
        length=length,
    )


def _first(names: Sequence[str], known: Sequence[str]) -> int | None:
    return next((names.index(name) for name in known if name in names), None)


def _with_bases(table: FrameTable, rows: Sequence[Sequence[str]], names: Sequence[str]) -> FrameTable:
    """Return the layout with the bases of identifiers and bytes: as the header or the numbers show them.

    A trace shows both in one base. It is decimal where no number has a letter, and one is no identifier, or
    no byte, as a hexadecimal number.
    """
    ids = [_plain_id(cells[table.identifier], 0) for cells in rows if cells[table.identifier].strip()]
    texts = [text for text, base, _ in ids if base == 0]
    payloads = [text for cells in rows for text in _byte_texts(cells[table.data[0]])]
    decimal = _all_decimal(texts) and any(int(text, 16) > _EXTENDED_MAX for text in texts)
    if len(table.data) == 1 and _all_decimal(payloads):
        decimal = decimal or (_all_decimal(texts) and any(int(text, 16) > 0xFF for text in payloads))
    base = 10 if decimal else 16
    return replace(
        table,
        id_base=_NAMED_BASES.get(names[table.identifier], base),
        data_base=_NAMED_BASES.get(names[table.data[0]], base),
    )


def _all_decimal(texts: Sequence[str]) -> bool:
    return bool(texts) and all(text.isdecimal() for text in texts)


def _plain_id(cell: str, base: int) -> tuple[str, int, bool]:
    """Return digits, base and whether the text marks 29 bits: 18FEF100x, 0x18FEF100, 18FEF100h, 419360000."""
    text = cell.strip()
    if text[:2].lower() == "0x":
        return text[2:], 16, False
    marked = text[-1:].lower() == "x"
    text = text[:-1] if marked else text
    if text[-1:].lower() == "h":
        return text[:-1], 16, marked
    return text, base, marked


def _byte_texts(cell: str) -> list[str]:
    """Return the bytes of a cell that has them all, divided by spaces or not at all."""
    texts = cell.replace("-", " ").split()
    if len(texts) == 1 and len(texts[0]) > 3 and len(texts[0]) % 2 == 0:
        return re.findall("..", texts[0])
    return [text[2:] if text[:2].lower() == "0x" else text for text in texts]


def _number(cell: str) -> str:
    return cell.strip().replace(",", ".")


def _is_set(cell: str) -> bool:
    return cell.strip().lower() in _YES
