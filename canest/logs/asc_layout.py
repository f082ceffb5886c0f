"""Lines of an .asc log: the kinds that most are of, and their layouts (as in `canest.logs.candump_layout`).

What a layout claims, python-can's reader reads the same way; every other line is left to it::

    0.001279 1  18FEEE31x       Rx   d 8 BA FF 62 B9 90 DF A2 C4  Length = 244000 BitCount = 126
    0.001571 1  123             Tx   r 4
    0.002000 1  ErrorFrame
    0.002500 CANFD   1 Rx   18FEEE31x    name    1 0 9 12 01 02 03 04 05 06 07 08 09 0A 0B 0C   0   0 ...
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, IntColumn
from canest.logs.candump_layout import Layout, Rows, fixed_characters
from canest.logs.candump_line import FD_LENGTHS
from canest.logs.swar import Words, decimal, hex_bytes

_WORD = 8
_MICROS_DIGITS = 6
#: whole seconds that a float64 gives back to the microsecond
_SECONDS_MAX = 2_000_000_000
_STAMP = rb"[ \t]*(?P<sec>\d{1,10})\.(?P<frac>\d{1,6})[ \t]+"
_ID = rb"(?P<id>[0-9A-Fa-f]{1,8})(?P<long>[xX]?)[ \t]+"
_CLASSIC = re.compile(
    _STAMP
    + rb"(?P<channel>\d{1,3})[ \t]+(?:(?P<error>ErrorFrame)|"
    + _ID
    + rb"[RT]x[ \t]+(?:d[ \t]+(?P<length>[0-8])(?P<data>(?: [0-9A-Fa-f]{2}){0,8})|r[ \t]+(?P<asked>\d)))"
    + rb"(?=[ \t]|\r?\Z)"
)
_FD = re.compile(
    _STAMP
    + rb"CANFD[ \t]+(?P<channel>\d{1,3})[ \t]+[RT]x[ \t]+"
    + _ID
    + rb"(?:[^\s\d]\S*[ \t]+)?[01][ \t]+[01][ \t]+[0-9a-fA-F][ \t]+(?P<length>\d{1,2})"
    + rb"(?P<data>(?: [0-9A-Fa-f]{2}){1,64})(?=[ \t]|\r?\Z)"
)


@dataclass(frozen=True, slots=True)
class AscLayout(Layout):
    """Offsets within a line, its end left free; build with `learn_line`.

    flags: of every identifier. fraction_digits: of the seconds.
    """

    flags: int
    fraction_digits: int

    @staticmethod
    def learn_line(text: bytes) -> AscLayout | None:
        """Return the layout of a line, None where it is of no common kind."""
        match = _CLASSIC.match(text) or _FD.match(text)
        if match is None or b"\r" in text[:-1] or int(match["sec"]) >= _SECONDS_MAX:
            return None
        part = match.groupdict()
        remote = part.get("asked") is not None
        length = int(part["length"] or part.get("asked") or 0)
        data = part["data"] or b""
        if not remote and (length not in FD_LENGTHS or len(data) < 3 * length):
            return None
        if match.re is _FD and not length:  # what python-can takes for a remote request
            return None
        seconds_at, seconds_end = match.span("sec")
        leading = max(0, seconds_end - seconds_at - _WORD)
        data_at = match.start("data") + 1 if data else 0
        spans = [(seconds_at + leading, seconds_end), match.span("frac")]
        if not part.get("error"):
            spans.append(match.span("id"))
        spans += [(data_at + 3 * i, data_at + 3 * i + 2) for i in range(length if data else 0)]
        end = data_at + 3 * length - 1 if data and length else match.end()
        # one more, which ends the last part
        known = text[: end + 1]
        flags = ERROR if part.get("error") else (EXTENDED * bool(part["long"]) | REMOTE * remote)
        return AscLayout(
            channel=str(int(match["channel"]) - 1).encode(),
            fixed=fixed_characters(known, {position for span in spans for position in range(*span)}),
            seconds_at=seconds_at + leading,
            seconds_digits=seconds_end - seconds_at - leading,
            seconds_base=int(text[seconds_at : seconds_at + leading] or b"0") * 10**_WORD,
            fraction_at=match.start("frac"),
            id_at=max(match.start("id"), 0),
            id_digits=len(part["id"] or b""),
            remote=remote,
            length=length,
            data_at=data_at,
            data_step=3,
            flags=flags,
            fraction_digits=len(part["frac"]),
        )

    def _identifiers(self, rows: Rows, fault: Words) -> NDArray[np.uint32]:
        if not self.id_digits:
            return np.full(rows.count, self.flags, np.uint32)
        reversed_id, bad = hex_bytes.interpreted(rows.field(self.id_at, self.id_digits))
        fault |= bad
        can_id: NDArray[np.uint32] = reversed_id.astype(np.uint32).byteswap()
        fault |= can_id & np.uint32(0xFFFF_FFFF ^ ID_MASK)
        return can_id | np.uint32(self.flags)

    def _stamps(self, rows: Rows, fault: Words) -> IntColumn:
        seconds, bad = decimal.interpreted(rows.field(self.seconds_at, self.seconds_digits))
        fault |= bad
        fraction, bad = decimal.interpreted(rows.field(self.fraction_at, self.fraction_digits))
        fault |= bad
        micros = fraction * np.uint64(10 ** (_MICROS_DIGITS - self.fraction_digits))
        t_us = (seconds + np.uint64(self.seconds_base)) * np.uint64(1_000_000) + micros
        stamps: IntColumn = t_us.view(np.int64)
        return stamps
