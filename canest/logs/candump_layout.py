"""A layout: where the parts of a candump line stand. All lines of one layout are parsed at once.

A log has few layouts (one per interface name, payload length and kind of identifier). A layout is learned
from one line that the tolerant parser understood; it then claims, from lines of the same width, those whose
every fixed character is the same and whose every variable character is a digit of the right kind. Whatever
it claims, the tolerant parser would have read the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from canest.core.frames import ERROR, EXTENDED, ID_MASK, REMOTE, BoolColumn, FrameBlock, IntColumn
from canest.logs.candump_line import STANDARD_ID_MAX, Line
from canest.logs.swar import ALL_BITS, ZERO_CHARS, Words, decimal, hex_bytes

_WORD = 8
_FRACTION_DIGITS = 6
_STANDARD_DIGITS = 3

assert EXTENDED == ERROR << 2  # how `_identifiers` marks whatever is not an error frame


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Lines of one width, one every ``stride`` characters; ``text`` goes on for a word behind the last."""

    text: NDArray[np.uint8]
    count: int
    stride: int

    @staticmethod
    def gather(text: NDArray[np.uint8], starts: IntColumn, width: int) -> Rows:
        """Copy the lines that begin at ``starts``, all ``width`` >= 8 characters wide without newline."""
        windows = np.ndarray(len(text) - width + 1, f"V{width}", text, strides=(1,))
        # the last line stands twice: words that begin in it may end behind it
        return Rows(windows[np.append(starts, starts[-1:])].view(np.uint8), len(starts), width)

    def words(self, offset: int) -> Words:
        """Return the eight characters at ``offset`` of every line."""
        return np.ndarray(self.count, "<u8", self.text, offset, (self.stride,)).copy()

    def field(self, offset: int, digits: int) -> Words:
        """Return ``digits`` <= 8 characters at ``offset`` of every line, zeros in front."""
        words = self.words(offset)
        if digits < _WORD:
            shift = 8 * (_WORD - digits)
            words <<= np.uint64(shift)
            words |= np.uint64(ZERO_CHARS & ((1 << shift) - 1))
        return words

    def four_bytes(self, offset: int, step: int, count: int) -> Words:
        """Return the hexadecimal digits of ``count`` <= 4 bytes, ``step`` characters apart, zeros behind."""
        if step == 2:
            words = self.words(offset)
        else:
            pairs = np.empty((self.count, 4), "<u2")
            for index in range(count):
                pairs[:, index] = np.ndarray(
                    self.count, "<u2", self.text, offset + step * index, (self.stride,)
                )
            words = pairs.view("<u8")[:, 0]
        if count < 4:
            mask = (1 << (16 * count)) - 1
            words = (words & np.uint64(mask)) | np.uint64(ZERO_CHARS & ~mask & ALL_BITS)
        return words


@dataclass(frozen=True, slots=True)
class Layout:
    """Offsets within a line; build with `learn`."""

    channel: bytes
    fixed: tuple[tuple[int, np.uint64, np.uint64], ...]  #: (offset, mask, value) of the fixed characters
    seconds_at: int
    seconds_digits: int
    seconds_base: int  #: seconds of the digits in front of the last eight, which are fixed
    fraction_at: int
    id_at: int
    id_digits: int
    remote: bool
    length: int
    data_at: int
    data_step: int  #: 2 when bytes follow each other, 3 when a blank stands between them

    @staticmethod
    def learn(text: bytes, line: Line) -> Layout | None:
        """Return the layout of a well-formed line; None where it is too odd to be worth one."""
        match = line.match
        part = match.groupdict()
        pairs = _byte_pairs(part["data"] or b"")
        if match.string != text or part["date"] or len(part["frac"]) != _FRACTION_DIGITS or pairs is None:
            return None
        if len(pairs) < line.length and not line.can_id & REMOTE:
            return None  # a CAN FD frame of which not all bytes stand there
        seconds_at, seconds_end = match.span("sec")
        leading = max(0, seconds_end - seconds_at - _WORD)
        spans = [(seconds_at + leading, seconds_end), match.span("frac"), match.span("id")]
        data_at = match.end("data") - len((part["data"] or b"").lstrip())
        data_step = 3 if b" " in (part["data"] or b"").strip() else 2
        spans += [(data_at + data_step * i, data_at + data_step * i + 2) for i in range(len(pairs))]
        if part.get("ascii"):
            spans.append((match.start("ascii") + 1, match.end("ascii") - 1))
        return Layout(
            channel=line.channel,
            fixed=fixed_characters(text, {position for span in spans for position in range(*span)}),
            seconds_at=seconds_at + leading,
            seconds_digits=seconds_end - seconds_at - leading,
            seconds_base=int(text[seconds_at : seconds_at + leading] or b"0") * 10**_WORD,
            fraction_at=match.start("frac"),
            id_at=match.start("id"),
            id_digits=len(part["id"]),
            remote=bool(line.can_id & REMOTE),
            length=line.length,
            data_at=data_at,
            data_step=data_step,
        )

    def parse(self, rows: Rows) -> tuple[FrameBlock, BoolColumn]:
        """Return one frame per line, and which lines really have this layout (the other frames are void)."""
        fault = np.zeros(rows.count, np.uint64)
        for offset, mask, value in self.fixed:
            fault |= (rows.words(offset) ^ value) & mask
        can_id = self._identifiers(rows, fault)
        t_us = self._stamps(rows, fault)
        data = self._payload(rows, fault)
        return FrameBlock(t_us, can_id, np.full(rows.count, self.length, np.uint8), data), fault == 0

    def _identifiers(self, rows: Rows, fault: Words) -> NDArray[np.uint32]:
        reversed_id, bad = hex_bytes.interpreted(rows.field(self.id_at, self.id_digits))
        fault |= bad
        can_id: NDArray[np.uint32] = reversed_id.astype(np.uint32).byteswap()
        if self.id_digits == _STANDARD_DIGITS:
            fault |= can_id > STANDARD_ID_MAX
        else:
            fault |= can_id & np.uint32(0xFFFF_FFFF ^ (ID_MASK | ERROR))
            can_id |= (~can_id & np.uint32(ERROR)) << np.uint32(2)
        return can_id | np.uint32(REMOTE) if self.remote else can_id

    def _stamps(self, rows: Rows, fault: Words) -> IntColumn:
        seconds, bad = decimal.interpreted(rows.field(self.seconds_at, self.seconds_digits))
        fault |= bad
        micros, bad = decimal.interpreted(rows.field(self.fraction_at, _FRACTION_DIGITS))
        fault |= bad
        t_us = (seconds + np.uint64(self.seconds_base)) * np.uint64(1_000_000) + micros
        stamps: IntColumn = t_us.view(np.int64)
        return stamps

    def _payload(self, rows: Rows, fault: Words) -> Words:
        halves = np.zeros((rows.count, 2), "<u4")
        for first in range(0, 0 if self.remote else self.length, 4):
            at = self.data_at + first * self.data_step
            four, bad = hex_bytes.interpreted(
                rows.four_bytes(at, self.data_step, min(4, self.length - first))
            )
            fault |= bad
            if first < _WORD:
                halves[:, first // 4] = four
        return halves.view("<u8")[:, 0]


def _byte_pairs(data: bytes) -> list[bytes] | None:
    """Return the payload bytes as written; None when they stand unevenly."""
    if b" " not in data.strip():
        return None if b"." in data else [data.strip()[i : i + 2] for i in range(0, len(data.strip()), 2)]
    pairs = data.split()
    return pairs if b" ".join(pairs) == data.strip() else None


def fixed_characters(text: bytes, variable: set[int]) -> tuple[tuple[int, np.uint64, np.uint64], ...]:
    """Cover the fixed characters of a line with few masked words."""
    words = []
    wanted = [position for position in range(len(text)) if position not in variable]
    while wanted:
        offset = wanted[0]
        covered = {position - offset for position in wanted if position < offset + _WORD}
        mask = bytes(0xFF if i in covered else 0 for i in range(_WORD))
        value = bytes(text[offset + i] if i in covered else 0 for i in range(_WORD))
        words.append(
            (offset, np.uint64(int.from_bytes(mask, "little")), np.uint64(int.from_bytes(value, "little")))
        )
        wanted = wanted[len(covered) :]
    return tuple(words)
