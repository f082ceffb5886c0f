"""A layout: where the parts of a candump line stand. All lines of one layout are parsed at once.

A log has few layouts (one per interface name, payload length and kind of identifier). A layout is learned from
one line that the tolerant parser understood; it then claims, from lines of the same width, those whose every
fixed character is the same and whose every variable character is a digit of the right kind. Whatever it
claims, the tolerant parser would have read the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.frames import ERROR, EXTENDED, ID_MASK, REMOTE, BoolColumn, FrameBlock
from canest.logs.lines import STANDARD_ID_MAX, Line
from canest.logs.swar import ZERO_CHARS, Words, decimal, hex_bytes

_WORD = 8
_STANDARD_DIGITS = 3
_ALL_BITS = (1 << 64) - 1
Matrix = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Layout:
    """Offsets within a line; build with `learn`."""

    channel: bytes
    fixed: tuple[tuple[int, np.uint64, np.uint64], ...]  #: (offset, mask, value) of the fixed characters
    seconds_at: int
    seconds_digits: int
    seconds_base: int  #: value of the leading digits beyond eight, which are fixed
    fraction_at: int
    id_at: int
    id_digits: int
    remote: bool
    length: int
    data_at: int
    data_step: int  #: 2 when bytes follow each other, 3 when a blank stands between them

    @staticmethod
    def learn(text: bytes, line: Line) -> Layout | None:
        """Return the layout of a well-formed line; None where it has no fixed one (dates, odd fractions)."""
        match = line.match
        if match.string != text or match["date"] is not None or len(match["frac"]) != 6:
            return None
        seconds_at, seconds_end = match.span("sec")
        data = match["data"] or b""
        pairs = data.split() if b" " in data else [data[i : i + 2] for i in range(0, len(data), 2)]
        data_at = match.start("data") + len(data) - len(data.lstrip()) if data else 0
        data_step = 3 if len(pairs) > 1 and len(data.strip()) > 2 * len(pairs) else 2
        span = data_step * (len(pairs) - 1) + 2 if pairs else 0
        if data.strip() != text[data_at : data_at + span]:
            return None  # dots between bytes, or more than one blank
        leading = max(0, seconds_end - seconds_at - _WORD)
        variable = set(range(seconds_at + leading, seconds_end)) | set(range(*match.span("frac")))
        variable |= set(range(*match.span("id")))
        for index in range(len(pairs)):
            variable |= {data_at + data_step * index, data_at + data_step * index + 1}
        if "ascii" in match.groupdict() and match["ascii"] is not None:
            variable |= set(range(match.start("ascii") + 1, match.end("ascii") - 1))
        return Layout(
            channel=line.channel,
            fixed=_fixed(text, variable),
            seconds_at=seconds_at + leading,
            seconds_digits=seconds_end - seconds_at - leading,
            seconds_base=int(text[seconds_at : seconds_at + leading] or b"0") * 10**_WORD,
            fraction_at=match.start("frac"),
            id_at=match.start("id"),
            id_digits=len(match["id"]),
            remote=bool(line.can_id & REMOTE),
            length=line.length,
            data_at=data_at,
            data_step=data_step,
        )

    def parse(self, lines: Matrix) -> tuple[FrameBlock, BoolColumn]:
        """Parse lines of one width, uint8 (n, width), in contiguous memory that goes on for 8 more bytes.

        Returns n frames and which of them are really lines of this layout; the others hold nothing of use.
        """
        fault = np.zeros(len(lines), np.uint64)
        for offset, mask, value in self.fixed:
            fault |= (_words(lines, offset) ^ value) & mask
        can_id = self._identifiers(lines, fault)
        t_us = self._stamps(lines, fault)
        data = self._payload(lines, fault)
        length = np.full(len(lines), self.length, np.uint8)
        return FrameBlock(t_us, can_id, length, data), fault == 0

    def _identifiers(self, lines: Matrix, fault: Words) -> NDArray[np.uint32]:
        big_endian, bad = hex_bytes(_right_aligned(lines, self.id_at, self.id_digits))
        fault |= bad
        can_id = big_endian.byteswap()
        if self.id_digits == _STANDARD_DIGITS:
            fault |= can_id > STANDARD_ID_MAX
        else:
            fault |= can_id & np.uint32(~(ID_MASK | ERROR) & 0xFFFF_FFFF)
            can_id |= (~can_id & np.uint32(ERROR)) << np.uint32(2)
        return can_id | np.uint32(REMOTE) if self.remote else can_id

    def _stamps(self, lines: Matrix, fault: Words) -> NDArray[np.int64]:
        seconds, bad = decimal(_right_aligned(lines, self.seconds_at, self.seconds_digits))
        fault |= bad
        micros, bad = decimal(_right_aligned(lines, self.fraction_at, 6))
        fault |= bad
        seconds += np.uint64(self.seconds_base)
        seconds *= np.uint64(1_000_000)
        seconds += micros
        return seconds.view(np.int64)

    def _payload(self, lines: Matrix, fault: Words) -> Words:
        data = np.zeros((len(lines), 2), np.uint32)
        for first in range(0, self.length if self.data_at else 0, 4):
            count = min(4, self.length - first)
            text = self._digits(lines, self.data_at + first * self.data_step, count)
            four, bad = hex_bytes(text)
            fault |= bad
            if first < _WORD:
                data[:, first // 4] = four
        return data.view("<u8")[:, 0]

    def _digits(self, lines: Matrix, offset: int, count: int) -> Words:
        """Return the hexadecimal digits of ``count`` payload bytes, filled up with zeros at the end."""
        if self.data_step == 2:
            text = _words(lines, offset)
        else:
            pairs = np.empty((len(lines), 4), "<u2")
            for index in range(count):
                pairs[:, index] = _strided(lines, offset + self.data_step * index, "<u2")
            text = pairs.view("<u8")[:, 0]
        if count < 4:
            mask = (1 << (16 * count)) - 1
            text = (text & np.uint64(mask)) | np.uint64(ZERO_CHARS & ~mask & _ALL_BITS)
        return text


assert EXTENDED == ERROR << 2  # how `_identifiers` marks what is not an error frame


def _fixed(text: bytes, variable: set[int]) -> tuple[tuple[int, np.uint64, np.uint64], ...]:
    """Cover the fixed characters of a line with few masked words."""
    wanted = [position for position in range(len(text)) if position not in variable]
    words = []
    while wanted:
        offset = wanted[0]
        covered = [position for position in wanted if position < offset + _WORD]
        mask = bytes(0xFF if offset + i in covered else 0 for i in range(_WORD))
        value = bytes(text[offset + i] if offset + i in covered else 0 for i in range(_WORD))
        words.append(
            (offset, np.uint64(int.from_bytes(mask, "little")), np.uint64(int.from_bytes(value, "little")))
        )
        wanted = wanted[len(covered) :]
    return tuple(words)


def _strided(lines: Matrix, offset: int, kind: str) -> NDArray[np.generic]:
    return np.ndarray(len(lines), kind, lines.base, _start(lines) + offset, (lines.strides[0],))
